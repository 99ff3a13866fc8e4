"""User settings: the config file, its keys and ranges, and named profiles."""

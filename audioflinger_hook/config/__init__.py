"""The user's choices: the config file, its keys and ranges, and named profiles."""

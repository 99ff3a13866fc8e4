"""What a user may choose: the config file, its keys and ranges, and named profiles."""

"""Services of the daemon that need no sound server and no device."""

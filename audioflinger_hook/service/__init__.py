"""Services of the daemon that need no sound server and no device.

| module | contents |
| --- | --- |
| `state` | the daemon's state |
| `meters` | levels and computing times, measured in the audio threads |
| `figure`, `status`, `shown` | descriptions of the status figures, and their text |
| `json_codec` | the status as JSON |
| `runtime_folder` | the private folder, and the lock for one daemon per user |
| `status_server`, `status_client` | the status socket and its client |
| `sync_trials` | the delay of the sound, estimated from a person's answers |
| `systemd` | notifications and the watchdog |
| `install` | the systemd unit and the udev rule |
| `autostart` | the start of the daemon at login, on or off |
| `desktop_entry` | entries of the application menu and of the autostart folder |
| `one_line` | conversion of untrusted text to one line |
"""

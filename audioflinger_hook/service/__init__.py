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
| `one_line` | conversion of untrusted text to one line |
"""

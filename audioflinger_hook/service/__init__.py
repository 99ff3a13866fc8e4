"""What a daemon needs besides sound; nothing here uses audio, a sound server or a device.

| module | contents |
| --- | --- |
| `state` | the daemon's state |
| `meters` | levels and buffer times, measured on the audio threads |
| `figure`, `status`, `shown` | the table of figures, and how they are shown |
| `status_view`, `json_codec` | the status as text and as JSON |
| `runtime_folder` | the private folder, and the lock for one daemon per user |
| `status_server`, `status_client` | the status socket and its client |
| `systemd` | notifications and the watchdog |
| `install` | the systemd unit and the udev rule |
| `one_line` | foreign text as one line |
"""

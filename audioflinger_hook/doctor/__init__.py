"""`cushion doctor`: reads the facts of a set-up, and finds what is wrong with it.

| module | contents |
| --- | --- |
| `facts` | the facts, as plain values |
| `machine` | reads versions, real-time permission, folders, the plugin's files and the daemon |
| `gather` | reads all facts |
| `servers` | reads the sound server and PipeWire's graph |
| `finding` | the form of a finding |
| `sound_rules` | rules about server, outputs and device; no I/O |
| `program_rules` | rules about permission, daemon, plugin, folders and config; no I/O |
| `findings` | applies all rules |
| `repair` | repairs that need no root |
| `measurement` | the measured delay from sound to vibration |
| `report` | findings and facts as text, with or without personal names |

Each read has a time limit, and a read that fails leaves its facts empty.
"""

"""`cushion doctor`: reads the facts of a set-up, and finds what is wrong with it.

| module | contents |
| --- | --- |
| `facts` | the facts, in the types of the modules that they come from |
| `machine` | reads versions, permissions, folders, the plugin's files, the config and the daemon |
| `servers` | reads the sound server and PipeWire's graph |
| `checks` | finds what is wrong; no I/O |
| `texts` | the texts of all findings |
| `repair` | repairs that need no root |
| `measurement` | the measured delay from sound to vibration |
| `report` | findings and facts as text, with or without personal names |

Each read has a time limit, and a read that fails leaves its facts empty.
"""

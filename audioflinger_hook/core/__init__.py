"""The core: sound in, the signals of actuators out; in C, without any input or output of its own.

    design (Python) --bytes--> core (C): sound -> mix -> transform -> history -> source and delay
                               -> level -> damping -> protection -> exposure -> fade -> readings

| file               | holds                                                                     |
| ------------------ | ------------------------------------------------------------------------- |
| core.h, core.c     | the interface, and one call of it                                         |
| core_sound.c       | sound as a host hands it over                                             |
| core_memory.c      | its memory, laid out                                                      |
| core_state.c       | its state, which another core of the same design goes on from             |
| core_design.c      | all that a core is made for, read from bytes                              |
| drive/actuator.c   | from vibration to the signal of one actuator                              |
| drive/protection.c | what protection does with each block                                      |
| drive/governor.c   | the gain that keeps two blocks within the limits                          |
| drive/exposure.c   | the dose of the day, and the gain that caps it                            |
| drive/drive_design.c | the above's designs, read from bytes                                    |
| compiled_core.py   | the compiled core for Python                                              |
| design.py          | designs as bytes                                                          |

The transform's C is in transform/native. Import modules directly; `compiled_core` loads the core.
"""

from __future__ import annotations

from pathlib import Path

FILE_NAME = "haptic_cushion.so"


def library_path() -> Path | None:
    """Return the compiled core, also the plugin for other hosts; None if not built. Any thread."""
    path = Path(__file__).with_name(FILE_NAME)
    return path if path.is_file() else None

"""The core: C code without I/O that turns sound into actuator signals.

    design (Python) --bytes--> core (C): sound -> mix -> transform -> history -> source and delay
                               -> level -> damping -> protection -> exposure -> fade -> readings

The interface is core.h in C and `compiled_core` in Python. The transform is in transform/native.
"""

from pathlib import Path

FILE_NAME = "haptic_cushion.so"


def library_path() -> Path | None:
    """Return the path of the compiled core, None if not built. Any thread may call this."""
    path = Path(__file__).with_name(FILE_NAME)
    return path if path.is_file() else None

"""The core: sound in, the signals of actuators out; in C, without any input or output of its own.

    design (Python) --bytes--> core (C): sound -> mix -> transform -> history -> source and delay
                               -> level -> damping -> protection -> exposure -> fade -> readings

core.h and core.c are the interface and one call of it. The transform's C is in transform/native.
Import modules directly; `compiled_core` loads the core.
"""

from __future__ import annotations

from pathlib import Path

FILE_NAME = "haptic_cushion.so"


def library_path() -> Path | None:
    """Return the compiled core, also the plugin for other hosts; None if not built. Any thread."""
    path = Path(__file__).with_name(FILE_NAME)
    return path if path.is_file() else None

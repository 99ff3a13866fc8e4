"""The effect as a plugin of other audio software: LADSPA and LV2."""

from __future__ import annotations

from pathlib import Path

FILE_NAME = "haptic_cushion.so"


def plugin_path() -> Path | None:
    """Return the compiled plugin, None if it is not built."""
    path = Path(__file__).with_name(FILE_NAME)
    return path if path.is_file() else None

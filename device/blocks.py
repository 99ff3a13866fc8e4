"""What is asked of every block of frames: compiled where that could be built, else in NumPy."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np

from device.extension import load
from device.units import Float32Array, FloatArray

compiled: ModuleType | None
"""`_blocks`, or None."""
try:
    compiled = load("device._blocks", "linear_motion")
except ImportError:
    compiled = None


def peak(frames: Float32Array | FloatArray) -> float:
    """Return the magnitude of the largest sample, NaN where one is not a number, 0.0 of none.

    frames: of any shape. Any thread may call it.
    """
    if compiled is not None:
        try:
            return float(compiled.peak(frames))
        except (BufferError, TypeError, ValueError):  # in another layout or of another type
            pass
    return float(np.max(np.abs(frames), initial=0.0))


def emptied(frames: Float32Array) -> bytes | None:
    """Return the bytes of a block, whose samples become 0; None where one is not finite.

    frames: contiguous. Nothing has changed where the answer is None. Any thread may call it.
    """
    if compiled is not None:
        taken: bytes | None = compiled.emptied(frames)
        return taken
    if not math.isfinite(peak(frames)):
        return None
    stored = frames.tobytes()
    frames.fill(0.0)
    return stored

"""From floats to the whole steps of an integer format: the one rounding rule of this project."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.units import FloatArray


def whole_steps(
    frames: NDArray[np.floating[Any]],
    full_scale: float,
    steps: FloatArray,
    rest: FloatArray,
    unknown: NDArray[np.bool_],
) -> None:
    """Write round(clip(x s, -s, s - 1)) into `steps`, half away from zero, 0 for NaN; no dither.

    frames: any shape, full scale ±1. full_scale: s, a power of two up to 2^31: exact in float64.
    steps, rest, unknown: of that shape; the last two are scratch. Nothing else is allocated. Any
    thread, with arrays of its own.
    """
    np.multiply(frames, full_scale, out=rest, dtype=np.float64)
    np.isnan(rest, out=unknown)
    np.copyto(rest, 0.0, where=unknown)
    np.clip(rest, -full_scale, full_scale - 1.0, out=rest)
    np.trunc(rest, out=steps)
    # not trunc(x + 0.5): that sum rounds 0.5 - 2^-54 up to 1; twice what is left over is exact
    np.subtract(rest, steps, out=rest)
    np.multiply(rest, 2.0, out=rest)
    np.trunc(rest, out=rest)
    np.add(steps, rest, out=steps)

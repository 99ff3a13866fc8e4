"""Operations on blocks of frames, most of them compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.compiled_blocks import Compiled, load_blocks
from device.errors import NotFoundError
from device.units import Float32Array, FloatArray

compiled: Compiled | None
"""The compiled operations; None if the library is missing or damaged."""
try:
    compiled = load_blocks()
except ImportError:
    compiled = None


def require_compiled() -> Compiled:
    """Return the compiled operations. NotFoundError: the library is missing or damaged."""
    if compiled is None:
        raise NotFoundError(
            "device/blocks_library.so is missing or damaged; run `make run` with a C compiler"
        )
    return compiled


def peak(frames: Float32Array | FloatArray) -> float:
    """Return the largest magnitude: NaN if any sample is NaN, 0.0 if there are no samples.

    frames: of any shape. Any thread may call it.
    """
    if compiled is not None:
        try:
            return float(compiled.peak(frames))
        except (BufferError, TypeError, ValueError):  # the array has another layout or type
            pass
    return float(np.max(np.abs(frames), initial=0.0))


def emptied(frames: Float32Array) -> bytes | None:
    """Return the bytes of a block and set its samples to 0; None if any sample is not finite.

    frames: contiguous. If the result is None, the block has not changed. Any thread may call it.
    """
    if not math.isfinite(peak(frames)):
        return None
    stored = frames.tobytes()
    frames.fill(0.0)
    return stored


def whole_steps(
    frames: NDArray[np.floating[Any]],
    full_scale: float,
    steps: FloatArray,
    rest: FloatArray,
    unknown: NDArray[np.bool_],
) -> None:
    """Write round(clip(x s, -s, s - 1)) into `steps`, half away from zero, 0 for NaN; no dither.

    frames: any shape, full scale ±1. full_scale: s, a power of two up to 2^31: exact in float64.
    steps, rest, unknown: arrays of the same shape; the last two are scratch. Nothing else is
    allocated. Any thread may call it with its own arrays.
    """
    np.multiply(frames, full_scale, out=rest, dtype=np.float64)
    np.isnan(rest, out=unknown)
    np.copyto(rest, 0.0, where=unknown)
    np.clip(rest, -full_scale, full_scale - 1.0, out=rest)
    np.trunc(rest, out=steps)
    # not trunc(x + 0.5): that sum rounds 0.5 - 2^-54 up to 1; twice the remainder is exact
    np.subtract(rest, steps, out=rest)
    np.multiply(rest, 2.0, out=rest)
    np.trunc(rest, out=rest)
    np.add(steps, rest, out=steps)

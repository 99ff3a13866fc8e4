"""Operations on blocks of frames, most of them compiled from device/native/."""

import ctypes
import math
from collections.abc import Sequence
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.errors import NotFoundError
from device.extension import refuse_cut_off
from device.units import Float32Array, FloatArray

FILE = Path(__file__).with_name("blocks_library.so")
_DESIGN = ("model", "table", "steps", "by_sample", "by_coarse")  # arrays of `ModelDesign`
_WRITTEN = ("state", "moved", "report", "out")


class _View(ctypes.Structure):
    """The structure `View` of native/blocks.h, which describes one array."""

    _fields_ = (("buf", c_void_p), ("ndim", c_size_t), ("shape", c_size_t * 3), ("len", c_size_t))


class Compiled:
    """The compiled operations. Two threads must not use the same array at the same time.

    An invalid argument raises TypeError, BufferError, ValueError or OverflowError, and no array
    changes. Arrays must be C-contiguous, and output arrays must be writable.
    ImportError: the library is missing or truncated, or lacks a function.
    """

    def __init__(self) -> None:
        try:
            refuse_cut_off(FILE)
            library = ctypes.PyDLL(str(FILE))
            self._peak = library.blocks_peak
            self._cubic = library.blocks_cubic
            self._linear_motion = library.blocks_linear_motion
            self._move_rig = library.blocks_move_rig
        except (OSError, AttributeError) as error:
            raise ImportError(f"{FILE}: {error}") from error
        view, size = POINTER(_View), POINTER(c_size_t)
        self._peak.restype, self._peak.argtypes = c_double, [c_void_p, c_size_t, c_int]
        self._cubic.argtypes = [view, view, c_size_t, c_double, c_double]
        self._linear_motion.argtypes = [view, c_size_t, c_size_t, c_double, size]
        self._move_rig.argtypes = [view, size]
        for function in (self._cubic, self._linear_motion, self._move_rig):
            function.restype = c_char_p

    def peak(self, frames: Float32Array | FloatArray) -> float:
        """Return the largest magnitude in a contiguous array; see the function `peak`."""
        kind = _type_of(frames)
        if kind not in (np.float32, np.float64):
            raise TypeError("frames: not an array of float32 or float64")
        if not frames.flags.c_contiguous:
            raise BufferError("frames: not contiguous")
        return float(self._peak(frames.ctypes.data, frames.size, kind == np.float64))

    def cubic(
        self, ring: Float32Array, out: Float32Array, row: int, fraction: float, step: float
    ) -> None:
        """Fill `out` by cubic interpolation of the ring buffer `ring`, both (frames, channels).

        Frame k of `out` is the value of the ring at frame row + 1 + fraction + k * step.
        """
        views = _views(np.float32, ring=ring, out=out)
        _check(self._cubic(views[0], views[1], _count(row), float(fraction), float(step)))

    def linear_motion(
        self,
        volts: FloatArray,
        poles: FloatArray,
        state: FloatArray,
        taps: FloatArray,
        moved: FloatArray,
        start: int,
        stop: int,
        limit: float,
    ) -> int:
        """Filter volts[start:stop] into moved[:, start:stop], one row for each computed quantity.

        poles: (2, 6), two all-pole second-order sections in series. taps: (quantities, 4), FIR
        coefficients for the last four outputs of the sections. state: (8,), updated. A voltage that
        is NaN or exceeds `limit` in magnitude counts as 0; return the number of such voltages.
        """
        views = _views(np.float64, volts=volts, poles=poles, state=state, taps=taps, moved=moved)
        found = c_size_t()
        numbers = _count(start), _count(stop), float(limit)
        _check(self._linear_motion(views, *numbers, byref(found)))
        return found.value

    def move_rig(
        self,
        volts: FloatArray,
        moved: FloatArray,
        design: Sequence[FloatArray],
        state: FloatArray,
        report: FloatArray,
        numbers: Sequence[int],
    ) -> None:
        """Simulate a rig: fill moved[:, start:stop], (4 or 5, frames), from volts[start:stop].

        design: `ModelDesign.arrays`. state: of `AdaptiveActuator`, updated. report: (blocks, 2),
        filled with 1 for the non-linear model, else 0, and with `BlockReport.estimate`.
        numbers: start, stop, frames of the first block, frames of each later block, and the model.
        Model 1 is linear, 2 is non-linear. 0 selects one of these models for each block.
        """
        named = dict(zip(_DESIGN, design, strict=True))
        views = _views(np.float64, volts=volts, moved=moved, **named, state=state, report=report)
        _check(self._move_rig(views, (c_size_t * len(numbers))(*map(_count, numbers))))


def _check(misfit: bytes | None) -> None:
    if misfit:
        raise ValueError(misfit.decode())


def _count(number: int) -> int:
    if not isinstance(number, int):
        raise TypeError(f"{number!r}: not a count")
    if not 0 <= number < 1 << 63:
        raise OverflowError(f"{number}: not a count")
    return number


def _type_of(array: object) -> object:
    return array.dtype if isinstance(array, np.ndarray) else None


def _views(dtype: type[np.floating[Any]], **arrays: NDArray[Any]) -> Any:
    """Return a `_View` of each array. Raise an error if an array has a wrong type or layout."""
    views = (_View * len(arrays))()
    for view, (name, array) in zip(views, arrays.items(), strict=True):
        if _type_of(array) != dtype:
            raise TypeError(f"{name}: not an array of {np.dtype(dtype)}")
        if not array.flags.c_contiguous or not array.flags.aligned:
            raise BufferError(f"{name}: not contiguous")
        if name in _WRITTEN and not array.flags.writeable:
            raise BufferError(f"{name}: cannot be written to")
        if array.ndim > 3:
            raise ValueError(f"{name}: {array.ndim} dimensions")
        view.buf, view.ndim, view.len = array.ctypes.data, array.ndim, array.nbytes
        view.shape[: array.ndim] = array.shape
    return views


compiled: Compiled | None  # None if the library is missing or damaged
try:
    compiled = Compiled()
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
    """Return the largest magnitude: NaN if any sample is NaN, 0.0 if there are no samples."""
    if compiled is not None:
        try:
            return float(compiled.peak(frames))
        except (BufferError, TypeError, ValueError):  # NumPy accepts every layout and type
            pass
    return float(np.max(np.abs(frames), initial=0.0))


def emptied(frames: Float32Array) -> bytes | None:
    """Return the bytes of a block and set its samples to 0.

    If any sample is not finite, return None and leave the block unchanged.
    frames: the block, contiguous. Any thread may call the function.
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
    """Quantize x to integers: write round(clip(x s, -s, s - 1)) into `steps`, without dither.

    Halves are rounded away from zero; NaN becomes 0. frames: x, any shape, full scale ±1.
    full_scale: s, a power of two up to 2^31. rest, unknown: scratch arrays. All arrays have the
    same shape. The function allocates no memory. Any thread may call it with its own arrays.
    """
    np.multiply(frames, full_scale, out=rest, dtype=np.float64)
    np.isnan(rest, out=unknown)
    np.copyto(rest, 0.0, where=unknown)
    np.clip(rest, -full_scale, full_scale - 1.0, out=rest)
    np.trunc(rest, out=steps)
    # trunc(x + 0.5) is wrong for 0.5 - 2^-54: the sum rounds to 1. The doubled rest is exact.
    np.subtract(rest, steps, out=rest)
    np.multiply(rest, 2.0, out=rest)
    np.trunc(rest, out=rest)
    np.add(steps, rest, out=steps)

"""Operations on blocks of frames, most of them compiled from device/native/."""

from __future__ import annotations

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
    """One array of native/blocks.h."""

    _fields_ = (("buf", c_void_p), ("ndim", c_size_t), ("shape", c_size_t * 3), ("len", c_size_t))


class Compiled:
    """What device/native/ computes; one thread at a time for one set of arrays.

    Every method raises TypeError, BufferError or ValueError, and changes nothing, where an array
    has another type, is not contiguous or is read-only, or where a number does not fit.

    ImportError: the library is missing, cut off or of another version.
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
        """Return what `blocks.peak` does, of a contiguous array."""
        kind = _type_of(frames)
        if kind not in (np.float32, np.float64):
            raise TypeError("frames: not an array of float32 or float64")
        if not frames.flags.c_contiguous:
            raise BufferError("frames: not contiguous")
        return float(self._peak(frames.ctypes.data, frames.size, kind == np.float64))

    def cubic(
        self, ring: Float32Array, out: Float32Array, row: int, fraction: float, step: float
    ) -> None:
        """Fill `out`: frame k is `fraction + k * step` after that in `row` + 1 of the ring."""
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
        """Fill moved[:, start:stop], (quantities, frames), from volts[start:stop].

        poles: (2, 6). state, (8,), goes on: two numbers for each section, then the last four that
        came through both. taps: (quantities, 4). Returns how many volts were beyond the limit or no
        numbers, and counted as 0.
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
        """Fill moved[:, start:stop], (4 or 5, frames), from volts[start:stop], (frames,).

        design, state: of `ModelDesign`; the state goes on. report, (blocks, 2): 1 for each block by
        the non-linear model, and the error of the linear one as far as it was estimated. numbers:
        start, stop, frames of the first block and of each other, and the model: 0 chooses block by
        block, 1 is linear, 2 non-linear.
        """
        named = dict(zip(_DESIGN, design, strict=True))
        views = _views(np.float64, volts=volts, moved=moved, **named, state=state, report=report)
        counts = (c_size_t * len(numbers))(*map(_count, numbers))
        _check(self._move_rig(views, counts))


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
    """Return arrays as the library takes them. TypeError, BufferError: one has no such layout."""
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
    """Return the largest magnitude: NaN if any sample is NaN, 0.0 if there are no samples.

    frames: of any shape and layout. Any thread may call it.
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

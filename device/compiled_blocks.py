"""The compiled operations on blocks of frames, for `blocks` and the rig's models."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.extension import refuse_cut_off
from device.units import Float32Array, FloatArray

FILE = Path(__file__).with_name("blocks_library.so")
WRITTEN = ("state", "moved", "report", "out")
"""Names of arrays that are written to."""


class _View(ctypes.Structure):
    """One array of native/blocks.h."""

    _fields_ = (
        ("buf", c_void_p),
        ("ndim", c_size_t),
        ("shape", c_size_t * 3),
        ("len", c_size_t),
    )


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
        """Return the largest magnitude: NaN if any sample is NaN, 0.0 if there are no samples."""
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
        model, table, steps, by_sample, by_coarse = design
        views = _views(
            np.float64,
            volts=volts,
            moved=moved,
            model=model,
            table=table,
            steps=steps,
            by_sample=by_sample,
            by_coarse=by_coarse,
            state=state,
            report=report,
        )
        _check(self._move_rig(views, _counts(*numbers)))


def load_blocks() -> Compiled:
    """Return what is compiled. ImportError: it is missing or unusable."""
    return Compiled()


def _check(misfit: bytes | None) -> None:
    if misfit:
        raise ValueError(misfit.decode())


def _count(number: int) -> int:
    if not isinstance(number, int):
        raise TypeError(f"{number!r}: not a count")
    if not 0 <= number < 1 << 63:
        raise OverflowError(f"{number}: not a count")
    return number


def _counts(*numbers: int) -> Any:
    return (c_size_t * len(numbers))(*map(_count, numbers))


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
        if name in WRITTEN and not array.flags.writeable:
            raise BufferError(f"{name}: cannot be written to")
        if array.ndim > 3:
            raise ValueError(f"{name}: {array.ndim} dimensions")
        view.buf, view.ndim, view.len = array.ctypes.data, array.ndim, array.nbytes
        view.shape[: array.ndim] = array.shape
    return views

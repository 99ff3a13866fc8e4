"""The compiled operations on blocks of frames, for `blocks` and the rig's models."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.extension import refuse_cut_off
from device.units import Float32Array, FloatArray

FILE = Path(__file__).with_name("blocks_library.so")
WRITTEN = ("state", "moved", "path", "report", "pair", "out")
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
            self._nonlinear_motion = library.blocks_nonlinear_motion
            self._linear_suffices = library.blocks_linear_suffices
        except (OSError, AttributeError) as error:
            raise ImportError(f"{FILE}: {error}") from error
        view, size = POINTER(_View), POINTER(c_size_t)
        self._peak.restype, self._peak.argtypes = c_double, [c_void_p, c_size_t, c_int]
        self._cubic.argtypes = [view, view, c_size_t, c_double, c_double]
        self._linear_motion.argtypes = [view, c_size_t, c_size_t, c_double, size]
        self._nonlinear_motion.argtypes = [view, size, c_size_t, size]
        self._linear_suffices.argtypes = [view, size, c_double, size]
        for function in (
            self._cubic,
            self._linear_motion,
            self._nonlinear_motion,
            self._linear_suffices,
        ):
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

    def nonlinear_motion(
        self,
        volts: FloatArray,
        moved: FloatArray,
        model: FloatArray,
        table: FloatArray,
        maps: FloatArray,
        bases: FloatArray,
        path: FloatArray,
        report: FloatArray,
        start: int,
        stop: int,
        first: int,
        each: int,
        mask: int,
    ) -> int:
        """Add the non-linear model's difference to moved[:, start:stop], (5, frames).

        moved: the linear solution of volts, (frames,); rows with a bit in `mask` change. The next
        arrays are those of `NonlinearModel`; path goes on. Each block, the first of `first` samples
        and the others of `each`, fills a row of report, (blocks, 4): peaks of excursion and
        acceleration, and the errors of both. Returns how many samples were before a step failed.
        """
        views = _views(
            np.float64,
            volts=volts,
            moved=moved,
            model=model,
            table=table,
            maps=maps,
            bases=bases,
            path=path,
            report=report,
        )
        found = c_size_t()
        numbers = _counts(start, stop, first, each)
        _check(self._nonlinear_motion(views, numbers, _count(mask), byref(found)))
        return found.value

    def linear_suffices(
        self,
        volts: FloatArray,
        moved: FloatArray,
        model: FloatArray,
        table: FloatArray,
        maps: FloatArray,
        bases: FloatArray,
        path: FloatArray,
        report: FloatArray,
        pair: FloatArray,
        start: int,
        stop: int,
        first: int,
        each: int,
        margin: float,
    ) -> int:
        """Return for how many of the first blocks `margin` times the Born term is small enough.

        Their rows of report are as above. pair, (2, 5), goes on to the end of those: the difference
        of the linear model, and that with the Born term. Volts and moved do not change.
        """
        views = _views(
            np.float64,
            volts=volts,
            moved=moved,
            model=model,
            table=table,
            maps=maps,
            bases=bases,
            path=path,
            report=report,
            pair=pair,
        )
        found = c_size_t()
        numbers = _counts(start, stop, first, each)
        _check(self._linear_suffices(views, numbers, float(margin), byref(found)))
        return found.value


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

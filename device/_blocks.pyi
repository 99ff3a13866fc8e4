"""The compiled part of `blocks.py`, `clock/interpolator.py` and `rig/actuator.py`; ask those."""

from device.units import Float32Array, FloatArray

def peak(frames: Float32Array | FloatArray) -> float:
    """Return the magnitude of the largest sample, NaN where one is not a number, 0.0 of none.

    Raises BufferError, TypeError or ValueError where the array is not contiguous float32 or
    float64.
    """

def emptied(frames: Float32Array) -> bytes | None:
    """Return the bytes of a block, whose samples become 0; None, and nothing changes, where one of
    them is not finite.

    Raises BufferError, TypeError or ValueError where the array is not contiguous float32 that can
    be written to.
    """

def cubic(ring: Float32Array, out: Float32Array, row: int, fraction: float, step: float) -> None:
    """Fill `out` as `CubicReader` does: frame k is at `fraction + k * step` after the one in `row`
    + 1 of the ring.

    Raises BufferError, TypeError or ValueError where an array is not contiguous float32 (frames,
    channels), or a number does not fit.
    """

def linear_motion(
    volts: FloatArray,
    poles: FloatArray,
    state: FloatArray,
    taps: FloatArray,
    moved: FloatArray,
    start: int,
    stop: int,
    limit: float,
) -> int:
    """Fill moved[:, start:stop], (quantities, frames), from volts[start:stop], as `LinearActuator`
    does with the sections `poles` (2, 6) and the `taps` (quantities, 4) of each quantity; return
    how many volts were beyond the limit or no numbers, and counted as 0.

    state, (8,), goes on: two numbers for each section, then the last four that came through both.
    Raises BufferError, TypeError, ValueError or OverflowError where an array is not contiguous
    float64 of its shape, or a number does not fit.
    """

def nonlinear_motion(
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
    """Add the non-linear model's difference to moved[:, start:stop], (5, frames), the linear
    solution of volts, (frames,); return how many samples that were before a step failed.

    Of moved, rows with a bit in `mask` change. The next arrays are those of `NonlinearModel`; path
    goes on. Each block, the first of `first` samples and the others of `each`, fills a row of
    report, (blocks, 4): peaks of excursion and acceleration, and the errors of both.
    """

def linear_suffices(
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
    """Return for how many of the first blocks `margin` times the Born term stays inside the
    model's tolerance; their rows of report are as above.

    pair, (2, 5), goes on to the end of those: the difference of the linear model, and that with the
    Born term. Volts and moved do not change.
    """

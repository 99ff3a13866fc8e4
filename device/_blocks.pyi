"""The compiled part of `blocks.py` and `clock/interpolator.py`, which are the way to use it."""

from device.units import Float32Array, FloatArray

def peak(frames: Float32Array | FloatArray) -> float:
    """Return the magnitude of the largest sample, NaN where one is not a number, 0.0 of none.

    Raises BufferError, TypeError or ValueError where the array is not contiguous float32 or
    float64.
    """

def cubic(ring: Float32Array, out: Float32Array, row: int, fraction: float, step: float) -> None:
    """Fill `out` as `CubicReader` does: frame k is at `fraction + k * step` after the one in `row`
    + 1 of the ring.

    Raises BufferError, TypeError or ValueError where an array is not contiguous float32 (frames,
    channels), or a number does not fit.
    """

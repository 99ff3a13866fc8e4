"""The array types of the transform, and overlapping windows of a signal."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.intp]
Frames = NDArray[np.floating[Any]]
"""Sound as it arrives: (frames, channels) or (frames,), float32 or float64, full scale +-1."""


def strided_windows(signal: FloatArray, frames: int, hop: int) -> FloatArray:
    """Return every whole window of `frames`, `hop` apart, as rows of a read-only view.

    signal: (n,) float64, contiguous. The same as `sliding_window_view(signal, frames)[::hop]`,
    whose checks cost more than the arithmetic of a short window.
    """
    count = (signal.size - frames) // hop + 1
    stride = signal.itemsize
    windows: FloatArray = np.ndarray(
        (count, frames), np.float64, signal, strides=(hop * stride, stride)
    )
    windows.flags.writeable = False
    return windows

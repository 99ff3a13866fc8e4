"""The most recent vibration in a ring buffer, readable at any delay."""

from __future__ import annotations

import numpy as np

from device.units import Float32Array, FloatArray


class DelayBuffer:
    """The last `delay_max` + `block_max` frames of vibration. One thread uses it.

    Parameters
    ----------
    sources : int
        Number of columns of a block.
    delay_max : int
        Longest delay in frames.
    block_max : int
        Longest block in frames.
    """

    def __init__(self, sources: int, delay_max: int, block_max: int) -> None:
        self._ring = np.zeros((sources, delay_max + block_max), np.float32)
        self._end = 0

    def add(self, vibration: Float32Array | FloatArray) -> None:
        """Store a block, (frames, sources), of up to `block_max` frames."""
        frames, size = len(vibration), self._ring.shape[1]
        first = min(frames, size - self._end)
        self._ring[:, self._end : self._end + first] = vibration[:first].T
        self._ring[:, : frames - first] = vibration[first:].T
        self._end = (self._end + frames) % size

    def read(self, source: int, delay: int, out: FloatArray) -> None:
        """Fill `out`, as long as the last block, with that source `delay` frames earlier.

        Frames before the first block are 0.
        """
        frames, size = len(out), self._ring.shape[1]
        start = (self._end - frames - delay) % size
        first = min(frames, size - start)
        out[:first] = self._ring[source, start : start + first]
        out[first:] = self._ring[source, : frames - first]

    def reset(self) -> None:
        """Set all stored frames to 0."""
        self._ring[:] = 0.0

"""The vibration of the last while, to be read again at any delay."""

from __future__ import annotations

import numpy as np

from device.units import Float32Array, FloatArray


class Past:
    """The last `frames_max` + `block_max` frames of vibration, (frames, sources), in a ring.

    All of its memory is taken when it is made. One thread holds it.
    """

    def __init__(self, sources: int, frames_max: int, block_max: int) -> None:
        self._ring = np.zeros((sources, frames_max + block_max), np.float32)
        self._end = 0

    def add(self, vibration: Float32Array | FloatArray) -> None:
        """Take a block of up to `block_max` frames."""
        frames, size = len(vibration), self._ring.shape[1]
        first = min(frames, size - self._end)
        self._ring[:, self._end : self._end + first] = vibration[:first].T
        self._ring[:, : frames - first] = vibration[first:].T
        self._end = (self._end + frames) % size

    def read(self, source: int, delay: int, out: FloatArray) -> None:
        """Write into `out` what came `delay` frames, up to `frames_max`, before the last of them.

        out: as many frames as the block that was added last; silence from before the first one.
        """
        frames, size = len(out), self._ring.shape[1]
        start = (self._end - frames - delay) % size
        first = min(frames, size - start)
        out[:first] = self._ring[source, start : start + first]
        out[first:] = self._ring[source, : frames - first]

    def reset(self) -> None:
        """Forget everything."""
        self._ring[:] = 0.0

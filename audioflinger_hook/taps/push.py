"""A tap that is handed its buffers, one at a time, by whoever captures them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class PushTap:
    """What was pushed comes out of `read`, once.

    format_changed and discontinuity are never true. Held by one thread, the one that captures.
    """

    format_changed = False
    discontinuity = False
    frames_expected = None

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self.channels = channels
        self._buffer: NDArray[np.float32] | None = None

    @property
    def waiting(self) -> bool:
        """Whether there is a buffer that was not read."""
        return self._buffer is not None

    def push(self, frames: NDArray[np.float32]) -> None:
        """Hand over a buffer, (frames, channels) float32; one that was not read is replaced."""
        self._buffer = frames

    def read(self) -> NDArray[np.float32] | None:
        """Return the buffer, None where there is none."""
        buffer, self._buffer = self._buffer, None
        return buffer

    def close(self) -> None:
        """Drop what is waiting."""
        self._buffer = None

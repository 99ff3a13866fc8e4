"""The ring between the client that writes a track and the mixer that reads it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class FrameRing:
    """A bounded ring of float32 frames: one thread writes, another reads, neither waits.

    `written` and `read` count frames since the start. Each is stored by one thread only, after the
    frames themselves were stored or used. So the other thread never sees a part of a buffer.
    """

    def __init__(self, capacity_frames: int, channels: int) -> None:
        self._frames = np.zeros((capacity_frames, channels), np.float32)
        self.capacity_frames = capacity_frames
        self.written = 0
        self.read = 0

    @property
    def room(self) -> int:
        """Frames that can be written now. For the writing thread."""
        return self.capacity_frames - (self.written - self.read)

    def spans_to_write(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The memory of the next `count` <= `room` frames, in order, the second may be empty."""
        return self._spans(self.written, count)

    def commit(self, count: int) -> None:
        """Hand `count` frames, now stored, to the reader. Called by the writing thread."""
        self.written += count

    def spans_to_read(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The next `count` written frames, in order, the second may be empty."""
        return self._spans(self.read, count)

    def consume(self, count: int) -> None:
        """Give the room of `count` frames back to the writer. Called by the reading thread."""
        self.read += count

    def skip_to(self, position: int) -> None:
        """Drop what was written before `position`. Called by the reading thread."""
        self.read = max(self.read, position)

    def _spans(self, position: int, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        first = position % self.capacity_frames
        wrapped = max(0, first + count - self.capacity_frames)
        return self._frames[first : first + count - wrapped], self._frames[:wrapped]

"""A tap that is handed its buffers, one at a time, by whoever captures them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class PushTap:
    """What was pushed comes out of `read`, once.

    samplerate, channels: of the buffers from now on; `change` sets them. format_changed: whether
    they differ from the buffer's before; discontinuity: whether frames are missing before it.
    Held by one thread, the one that captures.
    """

    frames_expected = None

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self.channels = channels
        self.format_changed = False
        self.discontinuity = False
        self._buffer: NDArray[np.float32] | None = None
        self._changed = self._broken = False

    @property
    def waiting(self) -> bool:
        """Whether there is a buffer that was not read."""
        return self._buffer is not None

    def change(self, samplerate: int, channels: int) -> bool:
        """Let the next buffers be the first of another opening; whether they have a new format.

        Called while nobody pushes.
        """
        changed = (samplerate, channels) != (self.samplerate, self.channels)
        self.samplerate, self.channels = samplerate, channels
        self._changed = self._changed or changed
        self._broken = True
        return changed

    def push(self, frames: NDArray[np.float32]) -> None:
        """Hand over a buffer, (frames, channels) float32; one that was not read is replaced."""
        self._buffer = frames

    def read(self) -> NDArray[np.float32] | None:
        """Return the buffer, None where there is none."""
        buffer, self._buffer = self._buffer, None
        if buffer is not None:
            self.format_changed, self._changed = self._changed, False
            self.discontinuity, self._broken = self._broken, False
        return buffer

    def close(self) -> None:
        """Drop what is waiting."""
        self._buffer = None

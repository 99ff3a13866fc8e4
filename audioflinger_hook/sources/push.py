"""A tap that is handed its buffers, one at a time, by whoever captures them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class PushTap:
    """A tap whose `read` returns each pushed buffer once.

    The capturing thread holds it; any thread may call `interrupt`.

    Parameters
    ----------
    samplerate : int
        Rate of the next buffers, Hz; `change` sets another one.
    channels : int
        Channels of the next buffers.

    Attributes
    ----------
    format_changed : bool
        Whether the buffer read last has another format than the one before it.
    discontinuity : bool
        Whether frames are missing before the buffer read last.
    """

    frames_expected = None

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self.channels = channels
        self.format_changed = False
        self.discontinuity = False
        self._buffer: NDArray[np.float32] | None = None
        self._format = (samplerate, channels)
        self._begun = self._broken = self._ended = False
        # replaced by the interrupting thread, compared by the capturing thread
        self._interruption = self._seen = object()

    @property
    def waiting(self) -> bool:
        """Whether a buffer was pushed and not read."""
        return self._buffer is not None

    @property
    def starved(self) -> bool:
        """Whether nothing can be read now, but more may follow."""
        return self._buffer is None and not self._ended

    def change(self, samplerate: int, channels: int) -> bool:
        """Set the format of the next buffers and return whether it is new. Not during `push`."""
        changed = (samplerate, channels) != (self.samplerate, self.channels)
        self.samplerate, self.channels = samplerate, channels
        return changed

    def interrupt(self) -> None:
        """Mark the next buffer as a discontinuity, unless it is the first one."""
        self._interruption = object()

    def push(self, frames: NDArray[np.float32]) -> bool:
        """Take a buffer, (frames, channels) float32, and return whether it is a discontinuity.

        An unread buffer is replaced.
        """
        interruption = self._interruption
        broken = self._begun and interruption is not self._seen
        self._seen = interruption
        self._begun = True
        self._broken = broken or self.waiting
        self._buffer = frames
        return self._broken

    def read(self) -> NDArray[np.float32] | None:
        """Return the buffer, or None."""
        buffer, self._buffer = self._buffer, None
        if buffer is not None:
            format_now = (self.samplerate, self.channels)
            self.format_changed = format_now != self._format
            self._format = format_now
            self.discontinuity = self._broken
        return buffer

    def end(self) -> None:
        """Mark the waiting buffer as the last one."""
        self._ended = True

    def close(self) -> None:
        """Drop the waiting buffer."""
        self._buffer = None

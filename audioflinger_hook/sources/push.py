"""A tap that is handed its buffers, one at a time, by whoever captures them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class PushTap:
    """What was pushed comes out of `read`, once.

    samplerate, channels: of the buffers from now on; `change` sets them. format_changed: whether
    the buffer read last has another format than the one before it, or than was given here;
    discontinuity: whether frames are missing before it. Held by one thread, the one that
    captures; any thread may call `interrupt`.
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
        # Replaced by whoever interrupts, looked at by the thread that captures.
        self._interruption = self._seen = object()

    @property
    def waiting(self) -> bool:
        """Whether there is a buffer that was not read."""
        return self._buffer is not None

    @property
    def starved(self) -> bool:
        """Whether there is nothing to read, and yet this is not the end."""
        return self._buffer is None and not self._ended

    def change(self, samplerate: int, channels: int) -> bool:
        """Let the next buffers have this format, Hz; whether it is a new one.

        Called while nobody pushes.
        """
        changed = (samplerate, channels) != (self.samplerate, self.channels)
        self.samplerate, self.channels = samplerate, channels
        return changed

    def interrupt(self) -> None:
        """Let frames be missing before the next buffer. Before the first one none are."""
        self._interruption = object()

    def push(self, frames: NDArray[np.float32]) -> bool:
        """Hand over a buffer, (frames, channels) float32; one that was not read is replaced.

        Returns whether frames are missing before it.
        """
        interruption = self._interruption
        broken = self._begun and interruption is not self._seen
        self._seen = interruption
        self._begun = True
        self._broken = broken or self.waiting
        self._buffer = frames
        return self._broken

    def read(self) -> NDArray[np.float32] | None:
        """Return the buffer, None where there is none."""
        buffer, self._buffer = self._buffer, None
        if buffer is not None:
            format_now = (self.samplerate, self.channels)
            self.format_changed = format_now != self._format
            self._format = format_now
            self.discontinuity = self._broken
        return buffer

    def end(self) -> None:
        """Let what is waiting be the last."""
        self._ended = True

    def close(self) -> None:
        """Drop what is waiting."""
        self._buffer = None

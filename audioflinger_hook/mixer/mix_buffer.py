"""The buffer that travels through mix, effects and sinks, and what a sink is."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class MixBuffer:
    """One cycle's frames, partially interleaved as on Android, full scale +-1, float32.

    `samples` is one flat array: frames x audio channels interleaved, and after them frames x
    haptic channels interleaved. `audio` (frames, channels) and `haptic` (frames,
    haptic_channels) are views of it. Held by the thread that steps the mixer.
    """

    def __init__(self, frames: int, channels: int, haptic_channels: int = 0) -> None:
        self._memory: NDArray[np.float32] = np.zeros(
            frames * (channels + haptic_channels), np.float32
        )
        self._channels = channels
        self._haptic_channels = haptic_channels
        self.hold(frames)

    def hold(self, frames: int) -> None:
        """Hold n frames from now on, at most the initial number; contents are undefined.

        A shorter buffer lies at the start of the same memory, its haptic region right behind its
        audio.
        """
        boundary = frames * self._channels
        self.samples = self._memory[: boundary + frames * self._haptic_channels]
        self.audio = self.samples[:boundary].reshape(frames, self._channels)
        self.haptic = self.samples[boundary:].reshape(frames, self._haptic_channels)

    @property
    def frames(self) -> int:
        """Frames in the buffer."""
        return len(self.audio)

    def clear(self) -> None:
        """Make everything silent."""
        self.samples[:] = 0.0


class Sink(Protocol):
    """Takes every buffer that the mixer writes. The mixer's thread calls it."""

    def write(self, buffer: MixBuffer) -> None:
        """Take one buffer; it belongs to the mixer again when this returns."""
        ...

    def standby(self) -> None:
        """Drop what was kept, since nothing follows for a while. The next `write` ends it."""
        ...

"""The buffer that passes mix, effects and sinks, its length, and what a sink is."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

NORMAL_MIN_MS = 20
NORMAL_MAX_MS = 24
ALIGNMENT = 16
"""AudioFlinger's normal mix buffer: its limits in ms, and frames of which it is a multiple."""


def normal_buffer_frames(samplerate: int, hal_frames: int) -> int:
    """Return the frames of a normal mix buffer: whole HAL buffers of 20 to 24 ms if possible.

    hal_frames: that the hardware takes at once (a HAL buffer); above 20 ms they stay unchanged. The
    result is a multiple of 16.
    """
    shortest = _round_up(NORMAL_MIN_MS * samplerate // 1000)
    longest = max(NORMAL_MAX_MS * samplerate // 1000 // ALIGNMENT * ALIGNMENT, shortest)
    if shortest <= hal_frames:
        return _round_up(hal_frames)
    if shortest <= 2 * hal_frames:
        # two HAL buffers, or the longest length allowed if two are too long
        return _round_up(min(2 * hal_frames, longest))
    return _round_up(shortest // hal_frames * hal_frames)


def _round_up(frames: int) -> int:
    return -(-frames // ALIGNMENT) * ALIGNMENT


class MixBuffer:
    """One cycle's frames, partially interleaved as on Android, full scale +-1, float32.

    `samples` is one flat array, all audio frames and after them all haptic frames. `audio` (frames,
    channels) and `haptic` (frames, haptic_channels) are views of it. Use from the thread that steps
    the mixer.
    """

    def __init__(self, frames: int, channels: int, haptic_channels: int = 0) -> None:
        self._memory = np.zeros(frames * (channels + haptic_channels), np.float32)
        self._channels = channels
        self._haptic_channels = haptic_channels
        self.hold(frames)

    @classmethod
    def like(cls, other: MixBuffer, memory: NDArray[np.float32]) -> MixBuffer:
        """Return a buffer of the same layout in other memory, (samples or more,) float32."""
        buffer = cls.__new__(cls)
        buffer._memory = memory
        buffer._channels, buffer._haptic_channels = other.audio.shape[1], other.haptic.shape[1]
        buffer.hold(other.frames)
        return buffer

    def hold(self, frames: int) -> None:
        """Hold this many frames from now on, at most the initial number; contents are undefined."""
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
        """Drop all frames kept, since none follow for a while. The next `write` ends this."""
        ...

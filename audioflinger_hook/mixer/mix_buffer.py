"""The buffer that mixer, effects and sinks share, and the interfaces of effects and sinks."""

from collections.abc import Collection
from typing import Protocol

import numpy as np

from device.units import Float32Array

NORMAL_MIN_MS, NORMAL_MAX_MS = 20, 24  # as in AudioFlinger
ALIGNMENT = 16  # buffer lengths are multiples of this number of frames, as in AudioFlinger
OUTPUT_MIX, OUTPUT_STAGE, DEVICE = 0, -1, -2
"""Sessions of the output mix, the output stage and the device. Players have sessions from 1 up."""


def normal_buffer_frames(samplerate: int, hal_frames: int) -> int:
    """Return the number of frames of a mix buffer, a multiple of 16.

    If a buffer of the hardware (HAL) lasts at least 20 ms, a mix buffer is equally long. If two HAL
    buffers together last at least 20 ms, it is as long as both, up to 24 ms. Otherwise it is as
    long as all HAL buffers that fit into 20 ms. hal_frames: frames per HAL buffer.
    """
    shortest = _round_up(NORMAL_MIN_MS * samplerate // 1000)
    longest = max(NORMAL_MAX_MS * samplerate // 1000 // ALIGNMENT * ALIGNMENT, shortest)
    if shortest <= hal_frames:
        return _round_up(hal_frames)
    if shortest <= 2 * hal_frames:
        # The length is two HAL buffers, limited to 24 ms.
        return _round_up(min(2 * hal_frames, longest))
    return _round_up(shortest // hal_frames * hal_frames)


def _round_up(frames: int) -> int:
    return -(-frames // ALIGNMENT) * ALIGNMENT


class MixBuffer:
    """Frames of one cycle, float32, full scale +-1. Only the mixer's thread may use them.

    `samples` (one-dimensional) has interleaved audio frames, then interleaved haptic frames, as on
    Android. `audio`, (frames, channels), and `haptic`, (frames, haptic_channels), are its views.
    """

    def __init__(self, frames: int, channels: int, haptic_channels: int = 0) -> None:
        self._memory = np.zeros(frames * (channels + haptic_channels), np.float32)
        self._channels, self._haptic_channels = channels, haptic_channels
        self.hold(frames)

    @classmethod
    def like(cls, other: "MixBuffer", memory: Float32Array) -> "MixBuffer":
        """Return a buffer of the same layout in `memory`, which must have enough samples."""
        buffer = cls.__new__(cls)
        buffer._memory = memory
        buffer._channels, buffer._haptic_channels = other.audio.shape[1], other.haptic.shape[1]
        buffer.hold(other.frames)
        return buffer

    def hold(self, frames: int) -> None:
        """Set the number of frames, at most the initial number. The samples become undefined."""
        boundary = frames * self._channels
        self.samples = self._memory[: boundary + frames * self._haptic_channels]
        self.audio = self.samples[:boundary].reshape(frames, self._channels)
        self.haptic = self.samples[boundary:].reshape(frames, self._haptic_channels)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.audio)

    def clear(self) -> None:
        """Set all samples to 0."""
        self.samples[:] = 0.0


class Sink(Protocol):
    """Receives every buffer that the mixer writes. The mixer's thread calls all methods."""

    def write(self, buffer: MixBuffer) -> None:
        """Take one buffer. The mixer reuses the buffer after this call."""

    def standby(self) -> None:
        """Drop stored frames, because the mixer pauses until the next `write`."""


class EffectsPort:
    """Interface to effect chains. Threads other than the mixer's may call only `dump`."""

    def sessions(self) -> Collection[int]:
        """Return the sessions that have an effect chain."""
        return ()

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        """Process a buffer in place with the session's chain. now_s: time in s, monotonic."""

    def end_of_cycle(self, now_s: float) -> None:
        """After each cycle except in standby, send waiting commands, such as ENABLE, to effects."""

    def set_format(self, samplerate: int, channels: int, haptic_channels: int, frames: int) -> None:
        """Set the format of all buffers. frames: largest number of frames of a buffer."""

    def dump(self) -> list[str]:
        """Return text lines: the number of chains, then the effects of each chain."""
        return ["0 Effect Chains"]

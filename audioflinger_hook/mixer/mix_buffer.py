"""The buffer that passes mix, effects and sinks, its length, and what effects and sinks are."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

import numpy as np

from device.units import Float32Array

NORMAL_MIN_MS, NORMAL_MAX_MS, ALIGNMENT = 20, 24, 16
"""AudioFlinger's normal mix buffer: its limits in ms, and frames of which it is a multiple."""

OUTPUT_MIX, OUTPUT_STAGE, DEVICE = 0, -1, -2
"""The sessions that belong to no player, in running order: mix of all players, stage after it,
device. A player's session is a number from 1 up."""


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

    `samples` is one flat array: the audio frames interleaved, then the haptic frames interleaved.
    `audio` (frames, channels) and `haptic` (frames, haptic_channels) are views of it. Use from the
    thread that steps the mixer.
    """

    def __init__(self, frames: int, channels: int, haptic_channels: int = 0) -> None:
        self._memory = np.zeros(frames * (channels + haptic_channels), np.float32)
        self._channels = channels
        self._haptic_channels = haptic_channels
        self.hold(frames)

    @classmethod
    def like(cls, other: MixBuffer, memory: Float32Array) -> MixBuffer:
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

    def standby(self) -> None:
        """Drop all frames kept, since none follow for a while. The next `write` ends this."""


class EffectsPort:
    """The effect chains by session, as the mixer sees them; these have none: the mix is unchanged.

    All calls come from the mixer's thread, but for `dump`.
    """

    def sessions(self) -> Collection[int]:
        """Return the sessions that have a chain now."""
        return ()

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        """Run the chain in place; `buffer.haptic` holds zeros or the output of earlier chains."""

    def end_of_cycle(self, now_s: float) -> None:
        """Do the work due at the end of a cycle that wrote, such as ENABLE or the end of a tail."""

    def set_format(self, samplerate: int, channels: int, haptic_channels: int, frames: int) -> None:
        """Set the format of all buffers from now on: before the first buffer, and at changes."""

    def dump(self) -> list[str]:
        """Return the number of chains as a heading, then each chain's effects. Any thread."""
        return ["0 Effect Chains"]

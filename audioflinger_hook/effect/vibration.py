"""The effect's output stage: transform, haptic channels, level, full scale, in that order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.transform import FloatArray, Frames, HapticTransform
from device.blocks import peak


class Vibration:
    """Vibration of one stream, scaled, in all haptic channels of the buffer.

    gain: 0 to 1; a new one is reached linearly over the next block, without a click. clip:
    whether samples beyond full scale are limited and counted. frames: of the largest block. Held
    by the thread that steps the mixer.
    """

    def __init__(self, transform: HapticTransform, gain: float, frames: int) -> None:
        self.gain = gain
        self.clip = True
        self._transform = transform
        self._next: HapticTransform | None = None
        self._level = gain
        self._limited_before = 0
        self._replaced_before = 0
        self._clipped = 0
        self.prepare(frames)

    def prepare(self, frames: int) -> None:
        """Make room for blocks of up to `frames`; the sound goes on."""
        self._column = np.zeros(frames)
        self._counted = np.arange(1.0, frames + 1.0)

    @property
    def latency_frames(self) -> int:
        """Frames by which vibration comes after its sound, of the newest transform."""
        return (self._next or self._transform).latency_frames

    @property
    def limited_samples(self) -> int:
        """Samples that the limiter or full scale has changed so far."""
        return self._limited_before + self._transform.limited_samples + self._clipped

    @property
    def replaced_samples(self) -> int:
        """Unusable samples of sound that were taken for 0 so far."""
        return self._replaced_before + self._transform.replaced_samples

    def change(self, transform: HapticTransform) -> None:
        """Change to another transform: the old one fades out over the next block.

        The new one starts from silence with the sound after that block.
        """
        self._next = transform

    def restart(self, transform: HapticTransform) -> None:
        """Change to another transform at once, for streams that are new or silent."""
        self._adopt(transform)

    def reset(self) -> None:
        """Forget all sound at once; counters go on."""
        if self._next is not None:
            self._adopt(self._next)
        self._transform.reset()
        self._level = self.gain

    def process(self, audio: Frames, out: NDArray[np.float32]) -> None:
        """Write to `out` (frames, haptic channels) the vibration due; `audio` is only read."""
        owed = self._transform.process(audio)
        if self._next is None:
            self._write(owed, out, self.gain)
        else:
            self._write(owed, out, 0.0)
            self._adopt(self._next)

    def drain(self, haptic_channels: int) -> NDArray[np.float32]:
        """Return the rest after the end of the sound, (latency_frames, haptic_channels)."""
        owed = self._transform.finish()
        out = np.zeros((len(owed), haptic_channels), np.float32)
        self._write(owed, out, self.gain)
        if self._next is not None:
            self._adopt(self._next)
        return out

    def _adopt(self, transform: HapticTransform) -> None:
        self._limited_before += self._transform.limited_samples
        self._replaced_before += self._transform.replaced_samples
        self._transform = transform
        self._next = None
        self._level = self.gain

    def _write(self, owed: FloatArray, out: NDArray[np.float32], goal: float) -> None:
        """Write vibration (frames, voices) to the haptic channels and arrive at the level `goal`.

        Where there are more haptic channels than voices, voices repeat: haptic channel h plays
        voice h mod voices. Where there are fewer, each plays the mean of voices h, h +
        haptic_channels, ...: none is left out, and equal voices keep their level.
        """
        level, self._level = self._level, goal
        if level == goal == 0.0:
            out[:] = 0.0
            return
        frames, voices = owed.shape
        places = out.shape[1]
        fits = frames <= self._column.size
        column = self._column[:frames] if fits else np.zeros(frames)
        counted = self._counted[:frames] if fits else np.arange(1.0, frames + 1.0)
        for place in range(places):
            np.copyto(column, owed[:, place % voices])
            if places < voices:
                # one by one: NumPy's order of a sum depends on the shape, so on the blocks
                for voice in range(place + places, voices, places):
                    column += owed[:, voice]
                column /= len(range(place, voices, places))
            if level != goal:
                column *= level + (goal - level) * (counted / frames)
            elif goal != 1.0:
                column *= goal
            if self.clip:
                self._clipped += cut_to_full_scale(column)
            out[:, place] = column


def cut_to_full_scale(samples: FloatArray) -> int:
    """Limit samples to +-1 in place and return how many were beyond."""
    if peak(samples) <= 1.0:
        return 0
    beyond = int(np.count_nonzero(np.abs(samples) > 1.0))
    np.clip(samples, -1.0, 1.0, out=samples)
    return beyond

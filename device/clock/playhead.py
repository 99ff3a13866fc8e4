"""The read position in a ring of frames: any ratio, and a fade at every discontinuity."""

from __future__ import annotations

import math

import numpy as np

from device.clock.interpolator import CubicReader
from device.clock.ring import NewestFrames
from device.units import Float32Array

FADE_S = 0.005
STEEPEST_HZ = 250.0
"""Top of the vibration band: extrapolated slopes are limited to that of a full-scale sine here."""
_SLOPE_S = 0.0005


class Playhead:
    """Plays a ring from a movable position. Called by the reading thread.

    ring: read from. samplerate: of the output, Hz. channels: of both.
    """

    def __init__(self, ring: NewestFrames, samplerate: float, channels: int) -> None:
        self._ring = ring
        self._reader = CubicReader(ring.frames)
        self._joint = Joint(samplerate, channels)
        self.readable = self._reader.readable
        self.jump_to = self._reader.jump_to
        self.join = self._joint.begin

    def behind(self, frames: float) -> float:
        """Return how far the position is behind that frame count."""
        return frames - self._reader.position - self._reader.fraction

    @property
    def overtaken(self) -> bool:
        """Whether the writer has overwritten the next frame."""
        return self._reader.position - 1 < self._ring.oldest

    def play(self, out: Float32Array, step: float) -> bool:
        """Fill `out` with readable frames; False if the writer overwrote them in the meantime."""
        first = self._reader.position - 1
        self._reader.read(out, step)
        if first < self._ring.oldest:
            return False
        self._joint.apply(out)
        return True

    def fall_silent(self, out: Float32Array) -> None:
        """Fill `out` with silence that the previous signal fades into."""
        out[:] = 0.0
        self._joint.apply(out)


class Joint:
    """Cross-fades from the previous signal to the next one over 5 ms, without a click.

    The old signal may have ended, so its last value and slope are extrapolated. The slope decays
    within 0.5 ms; both fall with a raised cosine while the new signal rises with the other half.
    Value and slope have no step. Silence is a signal like any other. Called by the reading thread.
    """

    def __init__(self, samplerate: float, channels: int) -> None:
        frames = max(2, round(FADE_S * samplerate))
        since = np.arange(1, frames + 1)[:, np.newaxis]
        self._rising = 0.5 - 0.5 * np.cos(np.pi * since / frames)
        self._falling = 1.0 - self._rising
        self._ramp = since * np.exp(-(since - 1) / (_SLOPE_S * samplerate)) * self._falling
        self._steepest = 2.0 * math.pi * STEEPEST_HZ / samplerate
        self._tail = np.zeros((frames, channels))
        self._scratch = np.zeros((frames, channels))
        self._last_two = np.zeros((2, channels), np.float32)
        self._done = frames

    def begin(self) -> None:
        """Start a fade at the next frame."""
        before, last = self._last_two.astype(np.float64)
        slope = np.clip(last - before, -self._steepest, self._steepest)
        np.multiply(self._falling, last, out=self._tail)
        self._tail += self._ramp * slope
        self._done = 0

    def apply(self, out: Float32Array) -> None:
        """Fade the next (frames, channels) in place, any number, and remember the last two."""
        if not len(out):
            return
        under_way = min(len(out), len(self._tail) - self._done)
        if under_way:
            now = slice(self._done, self._done + under_way)
            mixed = np.multiply(out[:under_way], self._rising[now], out=self._scratch[:under_way])
            mixed += self._tail[now]
            out[:under_way] = mixed
            self._done += under_way
        if len(out) == 1:
            self._last_two[0] = self._last_two[1]
        self._last_two[-len(out) :] = out[-2:]

"""Where a ring of frames is read, at any ratio and without a click."""

from __future__ import annotations

import math

import numpy as np

from device.clock.interpolator import CubicReader
from device.clock.ring import NewestFrames
from device.units import Float32Array


class Playhead:
    """The place in a ring of which the next frame is played. Called by the reading thread.

    ring: what is read; samplerate: of what comes out, Hz; channels: of both.
    """

    def __init__(self, ring: NewestFrames, samplerate: float, channels: int) -> None:
        self._ring = ring
        self._reader = CubicReader(ring.frames)
        self._joint = Joint(samplerate, channels)

    def behind(self, frames: float) -> float:
        """How far it is behind that count of frames."""
        return frames - self._reader.position - self._reader.fraction

    @property
    def overtaken(self) -> bool:
        """Whether what is to be played next was overwritten."""
        return self._reader.position - 1 < self._ring.oldest

    def readable(self, written: int, step: float) -> int:
        """How many frames can be played at `step`, with `written` frames in the ring."""
        return self._reader.readable(written, step)

    def jump_to(self, position: int) -> None:
        """Go to a frame."""
        self._reader.jump_to(position)

    def join(self) -> None:
        """Let the next frame be the first of another piece, or of silence."""
        self._joint.begin()

    def play(self, out: Float32Array, step: float) -> bool:
        """Fill with readable frames; False where the writer overtook while they were read."""
        first = self._reader.position - 1
        self._reader.read(out, step)
        if first < self._ring.oldest:
            return False
        self._joint.apply(out)
        return True

    def fall_silent(self, out: Float32Array) -> None:
        """Fill with silence, that what was played before fades into."""
        out[:] = 0.0
        self._joint.apply(out)

    def cut(self, out: Float32Array) -> None:
        """Fill with silence from the first frame on; what comes next rises from it."""
        out[:] = 0.0
        self._joint.cut()


FADE_S = 0.005
STEEPEST_HZ = 250.0
"""Top of the vibration's band: a full-scale sine of it is the steepest slope carried on."""
_SLOPE_S = 0.0005


class Joint:
    """Fades from what was last heard to what is heard next, over 5 ms.

    The old signal cannot be played on (it may be just its lack that ends it): its last value and
    slope are, the slope dying away in 0.5 ms, under the falling half of a raised cosine; the new
    signal rises under the other half. Value and slope so have no step at the join. Silence joins
    like any signal. Called by the reading thread.
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
        self._heard = np.zeros((2, channels), np.float32)  # the last two frames
        self._done = frames

    @property
    def at_rest(self) -> bool:
        """Whether no fade is under way and the last frame was silence."""
        return self._done == len(self._tail) and not self._heard[1].any()

    def begin(self) -> None:
        """Let the next frame be the first of another piece."""
        before, last = self._heard.astype(np.float64)
        slope = np.clip(last - before, -self._steepest, self._steepest)
        np.multiply(self._falling, last, out=self._tail)
        self._tail += self._ramp * slope
        self._done = 0

    def apply(self, out: Float32Array) -> None:
        """Fade the next (frames, channels) in place, any number of them, and remember the last."""
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
            self._heard[0] = self._heard[1]
        self._heard[-len(out) :] = out[-2:]

    def cut(self) -> None:
        """Take it that silence was heard; what comes next rises from it."""
        self._heard.fill(0.0)
        self.begin()

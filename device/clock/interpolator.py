"""Frames between frames: reading at a ratio that is not whole, and not constant."""

from __future__ import annotations

import math
from copy import copy

import numpy as np

from device.units import Float32Array, FloatArray

LOOKAHEAD = 2
"""Frames after the one at the position that must be there."""
_CHUNK = 512


class CubicReader:
    """Reads a ring of frames at any ratio, by the cubic through the four nearest frames.

    ring: float32 (capacity, channels), the frame `position` at row `position % capacity`; not
    copied, and only read. Called by the reading thread; its memory does not grow.

    Lagrange's cubic. Error under a full-scale sine at 48 kHz, over all fractions, float32 on both
    sides: -130 dB at 500 Hz, -148 at 250 Hz; Hermite's cubic through the same four frames
    (Catmull-Rom) has -110 and -128. At another rate the error is that of the frequency in
    proportion: the band must stay well under the rate, as vibration does.

    position, fraction: where the next frame is read, `fraction` in 0 to 1. They are kept apart
    because their sum would lose 20 bits of the fraction in a day.
    """

    def __init__(self, ring: Float32Array) -> None:
        self._ring = ring
        self._capacity = len(ring)
        self._taps = np.arange(4)[:, np.newaxis]
        self._memory = _Scratch(_CHUNK, ring.shape[1])
        self._scratch = self._memory
        self.position = 0
        self.fraction = 0.0

    def jump_to(self, position: int) -> None:
        """Go to a whole frame."""
        self.position = position
        self.fraction = 0.0

    def readable(self, written: int, step: float) -> int:
        """How many frames `read` can give at `step`, with `written` frames there; 0 or more."""
        reach = written - self.position - LOOKAHEAD - self.fraction
        return max(0, math.ceil(reach / step))

    def read(self, out: Float32Array, step: float) -> None:
        """Fill (frames, channels), any number of frames, and move on by `step` for each.

        step: frames of the ring for one of `out`, above 0.
        """
        for first in range(0, len(out), _CHUNK):
            self._read_chunk(out[first : first + _CHUNK], step)

    def _read_chunk(self, out: Float32Array, step: float) -> None:
        frames = len(out)
        if frames != len(self._scratch.at):
            self._scratch = self._memory.shortened(frames)
        now = self._scratch
        at, whole = now.at, now.whole
        np.multiply(now.count, step, out=at)
        at += self.fraction
        np.floor(at, out=whole)
        at -= whole
        np.add(whole, self._taps, out=now.rows, casting="unsafe")
        now.rows += (self.position - 1) % self._capacity
        _lagrange(at, now.weights)
        self._ring.take(now.rows, axis=0, out=now.near, mode="wrap")
        np.multiply(now.near, now.column_weights, out=now.weighted)
        np.add.reduce(now.weighted, axis=0, dtype=np.float64, out=out)
        end = self.fraction + frames * step
        self.position += math.floor(end)
        self.fraction = end - math.floor(end)


class _Scratch:
    """Memory for one chunk of `frames`; chunks of all lengths share it."""

    def __init__(self, frames: int, channels: int) -> None:
        self.count = np.arange(frames, dtype=np.float64)
        self.at = np.empty(frames)
        self.whole = np.empty(frames)
        self.rows = np.empty((4, frames), np.int64)
        self.weights = np.empty((4, frames))
        self.column_weights = self.weights[..., np.newaxis]
        self.near = np.empty((4, frames, channels), np.float32)
        self.weighted = np.empty((4, frames, channels))

    def shortened(self, frames: int) -> _Scratch:
        """The same memory for fewer frames."""
        short = copy(self)
        short.count, short.at = self.count[:frames], self.at[:frames]
        short.whole = self.whole[:frames]
        short.rows, short.weights = self.rows[:, :frames], self.weights[:, :frames]
        short.column_weights = short.weights[..., np.newaxis]
        # A slice of these would not be contiguous.
        shape = (4, frames, self.near.shape[2])
        short.near = self.near.reshape(-1)[: math.prod(shape)].reshape(shape)
        short.weighted = self.weighted.reshape(-1)[: math.prod(shape)].reshape(shape)
        return short


def _lagrange(s: FloatArray, weights: FloatArray) -> None:
    """Weights (4, frames) of the frames at -1, 0, 1 and 2 for a place `s` between 0 and 1."""
    before, after, beyond = s + 1.0, s - 1.0, s - 2.0
    outer, inner = s * after, before * beyond
    np.multiply(outer, beyond * (-1.0 / 6.0), out=weights[0])
    np.multiply(inner, after * 0.5, out=weights[1])
    np.multiply(inner, s * -0.5, out=weights[2])
    np.multiply(outer, before * (1.0 / 6.0), out=weights[3])

"""Interpolation between frames: reads at a ratio that is neither whole nor constant."""

from __future__ import annotations

import math
from copy import copy

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from device import blocks
from device.units import Float32Array, FloatArray

LOOKAHEAD = 2
"""Frames needed after the one at the position."""
_CHUNK = 512

_TAPS = 4
_LAGRANGE = np.array(
    [
        [0.0, -1.0 / 3.0, 1.0 / 2.0, -1.0 / 6.0],
        [1.0, -1.0 / 2.0, -1.0, 1.0 / 2.0],
        [0.0, 1.0, 1.0 / 2.0, -1.0 / 2.0],
        [0.0, -1.0 / 6.0, 0.0, 1.0 / 6.0],
    ]
)
"""Weights of the frames at -1, 0, 1 and 2 (rows) by powers 0 to 3 of the fraction."""


class CubicReader:
    """Reads a ring of frames at any ratio, by the Lagrange cubic through the four nearest frames.

    ring: float32 (capacity, channels), the frame `position` at row `position % capacity`; not
    copied, and only read. Called by the reading thread; its memory does not grow.

    The error under a full-scale sine at 48 kHz, over all fractions and with float32 on both sides,
    is -130 dB at 500 Hz and -148 dB at 250 Hz; Hermite's cubic (Catmull-Rom) has -110 and -128 dB.
    The error depends on the ratio of frequency to rate: the band must stay well under the rate.

    One compiled function does it, or NumPy if that could not be built: equal to the last bits of
    float32, at six times the cost.

    position, fraction: where the next frame is read, with `fraction` in 0 to 1. Their sum would
    lose 20 bits of the fraction in a day.
    """

    def __init__(self, ring: Float32Array) -> None:
        self._ring = ring
        self._capacity = len(ring)
        self._taps = np.arange(_TAPS)[:, np.newaxis]
        # Tap t of the frame in row r is in row r + t: no copy unless a row is past the end.
        self._near = np.moveaxis(sliding_window_view(ring, _TAPS, axis=0), -1, 0)
        self._memory = _Scratch(_CHUNK, ring.shape[1])
        self._scratch = self._memory
        self.position = 0
        self.fraction = 0.0

    def jump_to(self, position: int) -> None:
        """Move to a whole frame."""
        self.position = position
        self.fraction = 0.0

    def readable(self, written: int, step: float) -> int:
        """Return how many frames `read` can give at `step` after `written` frames; 0 or more."""
        reach = written - self.position - LOOKAHEAD - self.fraction
        return max(0, math.ceil(reach / step))

    def read(self, out: Float32Array, step: float) -> None:
        """Fill (frames, channels), any number of frames, and advance by `step` for each.

        step: frames of the ring per frame of `out`, above 0.
        """
        if self._read_compiled(out, step):
            self._move(len(out), step)
            return
        for first in range(0, len(out), _CHUNK):
            chunk = out[first : first + _CHUNK]
            self._read_chunk(chunk, step)
            self._move(len(chunk), step)

    def _move(self, frames: int, step: float) -> None:
        end = self.fraction + frames * step
        whole = math.floor(end)
        self.position += whole
        self.fraction = end - whole

    def _read_compiled(self, out: Float32Array, step: float) -> bool:
        if blocks.compiled is None:
            return False
        row = (self.position - 1) % self._capacity
        try:
            blocks.compiled.cubic(self._ring, out, row, self.fraction, step)
        except (BufferError, TypeError, ValueError):  # `out` has another layout
            return False
        return True

    def _read_chunk(self, out: Float32Array, step: float) -> None:
        frames = len(out)
        if frames != len(self._scratch.at):
            self._scratch = self._memory.shortened(frames)
        now = self._scratch
        row = (self.position - 1) % self._capacity
        # Usually the step is near 1 and no fraction leaves 0 to 1: then no frame is copied.
        drift = step - 1.0
        beside = 0.0 <= self.fraction + (frames - 1) * drift < 1.0
        if beside and row + frames + _TAPS - 1 <= self._capacity:
            np.matmul(_by_count(self.fraction, drift), now.powers, out=now.weights)
            near = self._near[:, row : row + frames]
        else:
            near = self._gather(now, row, step)
        np.multiply(near, now.column_weights, out=now.weighted)
        np.add.reduce(now.weighted, axis=0, dtype=np.float64, out=out)

    def _gather(self, now: _Scratch, row: int, step: float) -> Float32Array:
        """Set the weights and copy the four frames of every position."""
        at, whole = now.at, now.whole
        np.multiply(now.count, step, out=at)
        at += self.fraction
        np.floor(at, out=whole)
        at -= whole
        np.add(whole, self._taps, out=now.rows, casting="unsafe")
        now.rows += row
        _lagrange(at, now.weights)
        self._ring.take(now.rows, axis=0, out=now.near, mode="wrap")
        return now.near


class _Scratch:
    """Memory for one chunk; chunks of all lengths share it."""

    def __init__(self, frames: int, channels: int) -> None:
        self.count = np.arange(frames, dtype=np.float64)
        self.powers = self.count ** np.arange(_TAPS)[:, np.newaxis]
        self.at = np.empty(frames)
        self.whole = np.empty(frames)
        self.rows = np.empty((_TAPS, frames), np.int64)
        self.weights = np.empty((_TAPS, frames))
        self.column_weights = self.weights[..., np.newaxis]
        self.near = np.empty((_TAPS, frames, channels), np.float32)
        self.weighted = np.empty((_TAPS, frames, channels))

    def shortened(self, frames: int) -> _Scratch:
        """Return views of the same memory for fewer frames."""
        short = copy(self)
        short.count, short.at = self.count[:frames], self.at[:frames]
        short.powers, short.whole = self.powers[:, :frames], self.whole[:frames]
        short.rows, short.weights = self.rows[:, :frames], self.weights[:, :frames]
        short.column_weights = short.weights[..., np.newaxis]
        # A slice of these would not be contiguous.
        shape = (_TAPS, frames, self.near.shape[2])
        short.near = self.near.reshape(-1)[: math.prod(shape)].reshape(shape)
        short.weighted = self.weighted.reshape(-1)[: math.prod(shape)].reshape(shape)
        return short


def _by_count(first: float, drift: float) -> FloatArray:
    """Return weights (4, 4) by powers 0 to 3 of k, for the fractions `first + k * drift`."""
    square, square_drift = first * first, drift * drift
    by_count = [
        [1.0, 0.0, 0.0, 0.0],
        [first, drift, 0.0, 0.0],
        [square, 2.0 * first * drift, square_drift, 0.0],
        [square * first, 3.0 * square * drift, 3.0 * first * square_drift, square_drift * drift],
    ]
    weights: FloatArray = np.matmul(_LAGRANGE, by_count)
    return weights


def _lagrange(s: FloatArray, weights: FloatArray) -> None:
    """Set weights (4, frames) of the frames at -1, 0, 1 and 2 for fractions `s` from 0 to 1."""
    before, after, beyond = s + 1.0, s - 1.0, s - 2.0
    outer, inner = s * after, before * beyond
    np.multiply(outer, beyond * (-1.0 / 6.0), out=weights[0])
    np.multiply(inner, after * 0.5, out=weights[1])
    np.multiply(inner, s * -0.5, out=weights[2])
    np.multiply(outer, before * (1.0 / 6.0), out=weights[3])

"""The delay line's memory: the newest frames, read at any ratio and joined without clicks."""

from __future__ import annotations

import math

import numpy as np

from device import blocks
from device.units import Float32Array, FloatArray

LARGEST = 1e6  # greater magnitudes are a mistake that arithmetic might turn into inf
LOOKAHEAD = 2  # frames that interpolation needs after the one at the position
FADE_S = 0.005
STEEPEST_HZ = 250.0  # extrapolated slopes are limited to that of a full-scale sine here
_SLOPE_S = 0.0005


class NewestFrames:
    """A ring of the newest frames; the oldest are overwritten.

    One thread writes and one other reads, without locks. The writer sets `claimed`, stores the
    frames, and then publishes the new count elsewhere. The reader uses frames from `oldest` up to
    that count; they were intact if `oldest` is still behind them afterwards. Attributes must be
    loaded and stored atomically and in order, as CPython's are.

    frames: float32 (capacity, channels); frame k is in row k % capacity. claimed: count of frames
    that were or are being stored.
    """

    def __init__(self, capacity: int, channels: int) -> None:
        self.frames = np.zeros((capacity, channels), np.float32)
        self.claimed = 0

    @property
    def oldest(self) -> int:
        """Number of the oldest frame that is not being overwritten. Any thread may read it."""
        return self.claimed - len(self.frames)

    def store(self, block: Float32Array | FloatArray) -> int:
        """Store any number of (frames, channels), and return the new count of frames.

        Samples that are not finite, or beyond LARGEST, become 0. Called by the writing thread.
        """
        capacity = len(self.frames)
        self.claimed = end = self.claimed + len(block)
        block = block[-capacity:]
        first = (end - len(block)) % capacity
        before_end = min(len(block), capacity - first)
        _copy(block[:before_end], self.frames[first : first + before_end])
        _copy(block[before_end:], self.frames[: len(block) - before_end])
        return end


def _copy(block: Float32Array | FloatArray, rows: Float32Array) -> None:
    if blocks.peak(block) <= LARGEST:  # False for NaN
        rows[:] = block
        return
    with np.errstate(over="ignore", invalid="ignore"):
        rows[:] = block
        rows[~(np.abs(rows) <= LARGEST)] = 0.0  # also NaN


class CubicReader:
    """Reads a ring of frames at any ratio, by the Lagrange cubic through the four nearest frames.

    The error under a full-scale sine at 48 kHz is -130 dB at 500 Hz and -148 dB at 250 Hz.

    ring: `NewestFrames.frames`. position, fraction: where the next frame is read, with `fraction`
    in 0 to 1; their sum would lose 20 bits of the fraction in a day. Called by the reading thread.
    NotFoundError: the compiled blocks are missing.
    """

    def __init__(self, ring: Float32Array) -> None:
        self._ring = ring
        self._cubic = blocks.require_compiled().cubic
        self.jump_to(0)

    def jump_to(self, position: int) -> None:
        """Move to a whole frame."""
        self.position = position
        self.fraction = 0.0

    def readable(self, written: int, step: float) -> int:
        """Return how many frames `read` can give at `step` after `written` frames."""
        reach = written - self.position - LOOKAHEAD - self.fraction
        return max(0, math.ceil(reach / step))

    def read(self, out: Float32Array, step: float) -> None:
        """Fill any number of (frames, channels), and advance by `step`, above 0, for each."""
        frames = np.require(out, np.float32, ["C", "A", "W"])  # the array itself, unless strided
        self._cubic(self._ring, frames, (self.position - 1) % len(self._ring), self.fraction, step)
        if frames is not out:
            out[:] = frames
        end = self.fraction + len(out) * step
        self.position += math.floor(end)
        self.fraction = end - math.floor(end)


class Joint:
    """Cross-fades from the previous signal to the next one over 5 ms, without a click.

    The old signal may have ended, so its last value and slope are extrapolated. They fall with a
    raised cosine while the new signal rises, so neither has a step. Called by the reading thread.
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

"""One actuator's signal: source, delay and gain, which change without a click."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from device.units import Float32Array, FloatArray

FADE_S = 0.01
"""Duration of a change of gain, source or delay: slow enough not to click, too fast to notice."""


class DelayBuffer:
    """The last `delay_max` + `block_max` frames of vibration. One thread uses it.

    sources: number of columns of a block.
    delay_max: longest delay in frames.
    block_max: longest block in frames.
    """

    def __init__(self, sources: int, delay_max: int, block_max: int) -> None:
        self._ring = np.zeros((sources, delay_max + block_max), np.float32)
        self._end = 0

    def add(self, vibration: Float32Array | FloatArray) -> None:
        """Store a block, (frames, sources), of up to `block_max` frames."""
        frames, size = len(vibration), self._ring.shape[1]
        first = min(frames, size - self._end)
        self._ring[:, self._end : self._end + first] = vibration[:first].T
        self._ring[:, : frames - first] = vibration[first:].T
        self._end = (self._end + frames) % size

    def read(self, source: int, delay: int, out: FloatArray) -> None:
        """Fill `out`, as long as the last block, with a source, `delay` frames earlier.

        Frames before the first block are 0.
        """
        frames, size = len(out), self._ring.shape[1]
        start = (self._end - frames - delay) % size
        first = min(frames, size - start)
        out[:first] = self._ring[source, start : start + first]
        out[first:] = self._ring[source, : frames - first]

    def reset(self) -> None:
        """Set all stored frames to 0."""
        self._ring[:] = 0.0


class TapPoint(NamedTuple):
    """The place where a feed reads: the source's column, and the delay in frames."""

    source: int
    delay: int


class ActuatorFeed:
    """The signal of one actuator: a delayed source times a factor. One thread uses it.

    A change fades linearly. A second change of source or delay starts when the first has ended; if
    several wait, only the last is used. The result does not depend on the lengths of blocks, only
    on the frames at which changes were made.

    tap: the place where the feed reads.
    factor: multiplies the source, -1 to 1.
    fade_frames: length of a fade.
    """

    def __init__(self, tap: TapPoint, factor: float, fade_frames: int) -> None:
        self._fade = np.arange(1.0, fade_frames + 1.0) / fade_frames
        self._tap = self._next = self._wanted = tap
        self._tap_faded = fade_frames
        self._from = self._factor = factor
        self._factor_faded = fade_frames

    def change(self, tap: TapPoint, factor: float) -> None:
        """Fade to another tap point and factor from the next frame on."""
        self._wanted = tap
        if factor != self._factor:
            self._from, self._factor, self._factor_faded = self._current_factor(), factor, 0

    def read(self, delay_buffer: DelayBuffer, out: FloatArray, spare: FloatArray) -> None:
        """Fill `out`, (frames,), with the signal for the last block of `delay_buffer`.

        spare: scratch memory of the same length.
        """
        frames, whole, start = len(out), len(self._fade), 0
        delay_buffer.read(self._tap.source, self._tap.delay, out)
        while start < frames:
            if self._tap_faded == whole:
                if self._wanted == self._tap:
                    break
                self._next, self._tap_faded = self._wanted, 0
            count = min(whole - self._tap_faded, frames - start)
            share = self._fade[self._tap_faded : self._tap_faded + count]
            delay_buffer.read(self._next.source, self._next.delay, spare)
            new, old = spare[start : start + count], out[start : start + count]
            old += share * (new - old)
            self._tap_faded += count
            start += count
            if self._tap_faded == whole:
                self._tap = self._next
                out[start:] = spare[start:]
        self._apply_factor(out)

    def settle(self) -> None:
        """End all fades at once; call it only while nothing plays."""
        whole = len(self._fade)
        self._tap = self._next = self._wanted
        self._tap_faded = self._factor_faded = whole
        self._from = self._factor

    def _current_factor(self) -> float:
        """Return the factor of the last frame."""
        faded, whole = self._factor_faded, len(self._fade)
        if faded == whole:
            return self._factor
        share = float(self._fade[faded - 1]) if faded else 0.0
        return self._from + (self._factor - self._from) * share

    def _apply_factor(self, out: FloatArray) -> None:
        whole = len(self._fade)
        count = min(whole - self._factor_faded, len(out))
        if count:
            share = self._fade[self._factor_faded : self._factor_faded + count]
            out[:count] *= self._from + (self._factor - self._from) * share
            self._factor_faded += count
        if self._factor != 1.0:
            out[count:] *= self._factor

"""One actuator's way from the sources: which one, how late, how strong; changed without a click."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from device.drive.past import Past
from device.units import FloatArray

FADE_S = 0.01
"""Time in which another level is reached, and another source or delay faded to: no step that
clicks, and nobody waits for it."""


class Tap(NamedTuple):
    """Where it reads: the source's index, and how many frames ago."""

    source: int
    delay: int


class Path:
    """What one actuator gets: a source, `delay` frames late, times a factor of -1 to 1.

    fade_frames: over which a change is made: a line from factor to factor, and from one source or
    delay to another. A second change of these waits for the end of the first, and of several that
    wait the last one counts. No byte depends on how the stream is cut into blocks, only on the
    frame at which a change came. One thread holds it.
    """

    def __init__(self, tap: Tap, factor: float, fade_frames: int) -> None:
        self._fade = np.arange(1.0, fade_frames + 1.0) / fade_frames
        self._tap = self._next = self._wanted = tap
        self._tap_faded = fade_frames
        self._from = self._factor = factor
        self._factor_faded = fade_frames

    def change(self, tap: Tap, factor: float) -> None:
        """Go there from the next frame on."""
        self._wanted = tap
        if factor != self._factor:
            self._from, self._factor, self._factor_faded = self._now(), factor, 0

    def read(self, past: Past, out: FloatArray, spare: FloatArray) -> None:
        """Write into `out`, (frames,), what is due for the block that `past` took last.

        spare: as long, to be overwritten.
        """
        frames, whole, start = len(out), len(self._fade), 0
        past.read(self._tap.source, self._tap.delay, out)
        while start < frames:
            if self._tap_faded == whole:
                if self._wanted == self._tap:
                    break
                self._next, self._tap_faded = self._wanted, 0
            count = min(whole - self._tap_faded, frames - start)
            share = self._fade[self._tap_faded : self._tap_faded + count]
            past.read(self._next.source, self._next.delay, spare)
            new, old = spare[start : start + count], out[start : start + count]
            old += share * (new - old)
            self._tap_faded += count
            start += count
            if self._tap_faded == whole:
                self._tap = self._next
                out[start:] = spare[start:]
        self._apply_factor(out)

    def settle(self) -> None:
        """Be where it was to go, at once; for the time in which nothing plays."""
        whole = len(self._fade)
        self._tap = self._next = self._wanted
        self._tap_faded = self._factor_faded = whole
        self._from = self._factor

    def _now(self) -> float:
        """The factor of the last frame."""
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

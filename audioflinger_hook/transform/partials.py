"""Partials followed from hop to hop: matching, births, deaths, and small changes averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray

MATCH_HZ_A_WINDOW = 2.0
"""A partial may move by the window's main lobe's half-width, 2/T in audio Hz, in one hop ..."""

MATCH_RATIO = 0.12
"""... or by two semitones, whichever is more: a chirp of three octaves a second is followed."""

SPLIT_HZ = 2.0
"""A partial born this near to another, in Hz of vibration, is one that has split in two."""

STEADY_HZ = 0.05
"""Changes of vibration frequency well under this are averaged, well over it followed at once."""

STEADY_RATIO = 0.03
"""The same for changes of amplitude, as a ratio."""

STEADY_GAIN = 0.15
"""Share of the smallest changes that is followed a hop."""


@dataclass(frozen=True)
class Glides:
    """What each slot of the oscillator bank does in each hop: arrays (hops, slots), float64.

    Frequencies in Hz of vibration, amplitudes in full scale, phase in cycles at the hop's start.
    A slot at amplitude 0 at both ends is idle.
    """

    start_hz: FloatArray
    end_hz: FloatArray
    start_amplitude: FloatArray
    end_amplitude: FloatArray
    start_phase: FloatArray

    @classmethod
    def silent(cls, hops: int, slots: int) -> Glides:
        """Return glides in which every slot is idle."""
        return cls(*np.zeros((5, hops, slots)))

    def hops(self, first: int, last: int) -> Glides:
        """Return the hops from first up to last as a view."""
        return Glides(
            self.start_hz[first:last],
            self.end_hz[first:last],
            self.start_amplitude[first:last],
            self.end_amplitude[first:last],
            self.start_phase[first:last],
        )


class PartialTracker:
    """Turns each hop's list of partials into glides of a fixed number of slots.

    slope: of the mapping, as `scaling.slope` has it.
    Two sets of `partials_max` slots always suffice: in any hop one set lives and another fades.
    Held by one thread at a time.
    """

    def __init__(
        self, partials_max: int, hop_s: float, slope: tuple[float, float], window_s: float
    ) -> None:
        self.slots = 2 * partials_max
        self._hop_s = hop_s
        self._scale_hz, self._scale_ratio = slope
        self._match_audio_hz = MATCH_HZ_A_WINDOW / window_s
        self.reset()

    def reset(self) -> None:
        """Return to no partials at all."""
        self._hz = np.zeros(self.slots)
        self._amplitude = np.zeros(self.slots)
        self._phase = np.zeros(self.slots)
        self._alive = np.zeros(self.slots, dtype=bool)

    @property
    def idle(self) -> bool:
        """Whether no slot sounds: the next hop without partials is silent."""
        return not self._alive.any()

    def follow(
        self, glides: Glides, hop: int, audio_hz: FloatArray, hz: FloatArray, amplitude: FloatArray
    ) -> None:
        """Write one hop of `glides`: on to the partials that stand at its end.

        audio_hz, hz (of vibration), amplitude: (partials,), at least one, ascending in frequency.
        """
        slot, beside, gap_hz = self._match(audio_hz, hz)
        new = (slot < 0).nonzero()[0]
        if new.size:
            free = (~self._alive).nonzero()[0][: new.size]
            slot[new] = free
            # One peak that wavers between one and two, as a fast chirp's does, would otherwise be
            # in and out of step with itself.
            split = gap_hz.take(new) < SPLIT_HZ
            self._phase[free] = np.where(split, self._phase.take(beside.take(new)), 0.0)
            self._hz[free] = hz.take(new)
        glides.start_hz[hop] = self._hz
        glides.start_amplitude[hop] = self._amplitude
        glides.start_phase[hop] = self._phase

        before = self._hz.take(slot)
        change = hz - before
        after = before + change * _followed(change / STEADY_HZ)
        level = self._amplitude.take(slot)
        change = amplitude - level
        self._hz[slot] = after
        self._amplitude[:] = 0.0
        self._amplitude[slot] = level + change * _followed(change / (STEADY_RATIO * amplitude))
        self._alive[:] = False
        self._alive[slot] = True
        self._finish_hop(glides, hop)

    def fade(self, glides: Glides, hop: int) -> None:
        """Write one hop of `glides` in which every partial that sounds dies away."""
        glides.start_hz[hop] = self._hz
        glides.start_amplitude[hop] = self._amplitude
        glides.start_phase[hop] = self._phase
        self._amplitude[:] = 0.0
        self._alive[:] = False
        self._finish_hop(glides, hop)

    def _finish_hop(self, glides: Glides, hop: int) -> None:
        glides.end_hz[hop] = self._hz
        glides.end_amplitude[hop] = self._amplitude
        # The mean frequency of a symmetric glide is that of its ends.
        self._phase += (0.5 * self._hop_s) * (glides.start_hz[hop] + self._hz)
        self._phase -= np.floor(self._phase)

    def _match(self, audio_hz: FloatArray, hz: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return each partial's slot, -1 where it is new; the slot nearest to it, and how near.

        A slot is a partial's own where they are nearest to one another and within reach. The
        distance is in Hz of vibration; where no slot sounds it is infinite.
        """
        alive = self._alive.nonzero()[0]
        if not alive.size:
            return np.full(hz.size, -1), np.zeros(hz.size, dtype=np.intp), np.full(hz.size, np.inf)
        distance = np.abs(hz[:, None] - self._hz.take(alive))
        nearest = distance.argmin(axis=1)
        gap_hz = distance.min(axis=1)
        slope_hz = self._scale_hz + self._scale_ratio * hz
        reach_hz = slope_hz * np.maximum(MATCH_RATIO, self._match_audio_hz / audio_hz)
        mutual = distance.argmin(axis=0).take(nearest) == np.arange(hz.size)
        mutual &= gap_hz <= reach_hz
        beside = alive.take(nearest)
        return np.where(mutual, beside, -1), beside, gap_hz


def _followed(relative_change: FloatArray) -> FloatArray:
    """Return the share of a change that is followed: all of a clear one, little of a jitter."""
    return np.minimum(1.0, STEADY_GAIN + relative_change * relative_change)

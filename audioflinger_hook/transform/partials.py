"""Partials followed from hop to hop: matching, births, deaths, and small changes averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray

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

    Two sets of `partials_max` slots always suffice: in any hop one set lives and another fades.
    Held by one thread at a time.
    """

    def __init__(self, partials_max: int, hop_s: float, scale_hz: float, window_s: float) -> None:
        self.slots = 2 * partials_max
        self._hop_s = hop_s
        self._scale_hz = scale_hz
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
        slot = self._match(audio_hz, hz)
        new = slot < 0
        if new.any():
            free = (~self._alive).nonzero()[0][: np.count_nonzero(new)]
            slot[new] = free
            self._phase[free] = self._phase_at_birth(hz[new])
            self._hz[free] = hz[new]
        glides.start_hz[hop] = self._hz
        glides.start_amplitude[hop] = self._amplitude
        glides.start_phase[hop] = self._phase

        before = self._hz[slot]
        change = hz - before
        after = before + change * _followed(change / STEADY_HZ)
        level = self._amplitude[slot]
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

    def _phase_at_birth(self, hz: FloatArray) -> FloatArray:
        """Return the phases that new partials start with: 0, or that of a partial which split.

        One peak that wavers between one and two, as a fast chirp's does, would otherwise be in
        and out of step with itself.
        """
        alive = self._alive.nonzero()[0]
        if not alive.size:
            return np.zeros(hz.size)
        distance = np.abs(hz[:, None] - self._hz[alive])
        nearest = distance.argmin(axis=1)
        split = distance[np.arange(hz.size), nearest] < SPLIT_HZ
        return np.where(split, self._phase[alive[nearest]], 0.0)

    def _match(
        self, audio_hz: FloatArray, hz: FloatArray
    ) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """Return each partial's slot, -1 where it is new: mutual nearest neighbours in reach."""
        slot = np.full(len(hz), -1, dtype=np.intp)
        alive = self._alive.nonzero()[0]
        if not alive.size:
            return slot
        distance = np.abs(hz[:, None] - self._hz[alive])
        reach = self._scale_hz * np.maximum(MATCH_RATIO, self._match_audio_hz / audio_hz)
        nearest_slot = distance.argmin(axis=1)
        nearest_partial = distance.argmin(axis=0)
        partial = np.arange(len(hz))
        mutual = (nearest_partial[nearest_slot] == partial) & (
            distance[partial, nearest_slot] <= reach
        )
        slot[mutual] = alive[nearest_slot[mutual]]
        return slot


def _followed(relative_change: FloatArray) -> FloatArray:
    """Return the share of a change that is followed: all of a clear one, little of a jitter."""
    return np.minimum(1.0, STEADY_GAIN + relative_change**2)

"""Partials followed from hop to hop: matching, births, deaths, and small changes averaged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.live.merging import merge
from audioflinger_hook.transform.live.synthesis import Glides

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Held:
    """What keeps a partial that was born of an onset: its amplitude at least, while it is heard.

    amplitude: in full scale, with what sounded near to it before. weight: what the law was taken
    to leave it of its sound's level. group: of bands, by which it is heard. loudness: their power
    then.
    """

    amplitude: float
    weight: float
    group: tuple[int, int]
    power: float


class PartialTracker:
    """Turns each hop's list of partials into glides of a fixed number of slots.

    Two sets of `partials_max` + `fresh_max` slots always suffice: in any hop one set lives and
    another fades. Use from one thread at a time.
    """

    def __init__(self, design: LiveDesign) -> None:
        self._design = design.tracking
        self._mapping = design.mapping
        self._hop_s = design.grid.hop_s
        self._followed = design.loudness.loudness_weights.size > 0
        self._felt_weights = design.loudness.felt_weights
        self._felt_hz = design.synthesis.gain_step_hz * np.arange(self._felt_weights.size)
        self._most = design.analysis.partials_max + design.onsets.fresh_max
        self.slots = 2 * self._most
        self.reset()

    def reset(self) -> None:
        """Return to no partials at all."""
        self._hz = np.zeros(self.slots)
        self._amplitude = np.zeros(self.slots)
        self._phase = np.zeros(self.slots)
        self._alive = np.zeros(self.slots, dtype=bool)
        self._start_sum = 0.0
        self._struck = 0.0
        self._struck_hops = 0
        self._held: dict[int, tuple[Held, int]] = {}

    @property
    def holds(self) -> bool:
        """Whether a partial is held that no window has shown yet."""
        return bool(self._held)

    @property
    def loudest_sum(self) -> float:
        """The larger of both ends' sums of amplitudes, of the last hop that was written."""
        return max(self._start_sum, float(self._amplitude.sum()))

    def sounding_near(self, hz: float) -> float:
        """Return the amplitudes near to a vibration frequency at the end of the hop."""
        near = self._alive & (np.abs(self._hz - hz) < self.near_hz(hz))
        return float(self._amplitude[near].sum())

    def strongest_near(self, hz: float, before_end_s: float) -> tuple[float, float] | None:
        """Return frequency and phase of the strongest partial near to a vibration frequency.

        The phase is that of so many seconds before the end of the hop, in cycles. None: there is
        no such partial, or partials are not merged.
        """
        if not self._design.merge_ratio:
            return None
        near = self._alive & (np.abs(self._hz - hz) < self.near_hz(hz))
        most, found = self._design.joined_from, -1
        for slot in near.nonzero()[0].tolist():
            if self._amplitude[slot] > self._design.stronger * most:
                most, found = float(self._amplitude[slot]), slot
        if found < 0:
            return None
        phase = float(self._phase[found]) - float(self._hz[found]) * before_end_s
        return float(self._hz[found]), phase - math.floor(phase)

    def near_hz(self, hz: float) -> float:
        """Return how far from a new partial its true frequency may be, in Hz of vibration."""
        return self._design.near_hz(hz, self._mapping)

    def adopt(self, hz: float, phase: float, amplitude: float, held: Held) -> None:
        """Take over a partial in the middle of its vibration, and hold it; at the end of a hop.

        hz: of vibration; phase: in cycles. Where there is no room left it ends.
        """
        if int(self._alive.sum()) >= self._most:
            return
        slot = int((~self._alive).nonzero()[0][0])
        self._hz[slot], self._phase[slot], self._amplitude[slot] = hz, phase, amplitude
        self._alive[slot] = True
        self._held[slot] = held, self._design.hold_hops
        self._struck, self._struck_hops = self._felt(), self._design.hold_hops

    @property
    def idle(self) -> bool:
        """Whether no slot sounds: the next hop without partials is silent."""
        return not self._alive.any()

    def follow(
        self,
        glides: Glides,
        hop: int,
        audio_hz: FloatArray,
        hz: FloatArray,
        amplitude: FloatArray,
        room: float,
        held_amplitude: Callable[[Held], float],
        left: float,
    ) -> None:
        """Write one hop of `glides`: on to the partials that stand at its end.

        audio_hz, hz (of vibration), amplitude: (partials,), ascending in frequency. room: what
        partials that are held may add to the sum of amplitudes. held_amplitude: what those are to
        have now. left: what the law leaves of the level of what this window shows, which separates
        tones that were one for an onset.
        """
        dominance = np.ones(hz.size)
        if self._design.merge_ratio and hz.size:
            sounding_hz = self._hz[self._alive].tolist()
            hz, amplitude, dominance = merge(self._design, hz, amplitude, sounding_hz)
            audio_hz = np.array([self._mapping.audio_hz(one) for one in hz.tolist()])
        slot, beside, gap_hz = self._match(audio_hz, hz)
        new = (slot < 0).nonzero()[0]
        if new.size:
            free = (~self._alive).nonzero()[0][: new.size]
            slot[new] = free
            # One peak that wavers between one and two, as a fast chirp's does, would otherwise be
            # in and out of step with itself.
            split = gap_hz.take(new) < self._design.split_hz
            self._phase[free] = np.where(split, self._phase.take(beside.take(new)), 0.0)
            self._hz[free] = hz.take(new)
        self._begin_hop(glides, hop)

        before = self._hz.take(slot)
        change = hz - before
        share = self._followed_share(change / self._design.steady_hz)
        after = before + change * share * dominance
        level = self._amplitude.take(slot)
        change = amplitude - level
        self._hz[slot] = after
        self._amplitude[:] = 0.0
        self._amplitude[slot] = level + change * self._followed_share(
            change / (self._design.steady_ratio * amplitude)
        )
        self._alive[:] = False
        self._alive[slot] = True
        self._hold(room, held_amplitude, left)
        self._stay_under_onset()
        self._finish_hop(glides, hop)

    def _hold(self, room: float, held_amplitude: Callable[[Held], float], left: float) -> None:
        """Keep what is held at its amplitude, as far as there is room and the law leaves it."""
        lacking = {}
        by_slot = sorted(self._held.items())
        squares = sum(held.weight * held.weight for _, (held, _) in by_slot)
        known = 1.0 if squares <= left * left else left / float(np.sqrt(squares))
        for slot, (held, hops) in by_slot:
            wanted = held_amplitude(held)
            full = not self._alive[slot] and int(self._alive.sum()) >= self._most
            if full or hops < 1 or wanted < self._design.worth_holding * held.amplitude:
                del self._held[slot]
                continue
            self._held[slot] = held, hops - 1
            self._alive[slot] = True
            wanted *= known
            lacking[slot] = max(0.0, wanted - self.sounding_near(float(self._hz[slot])))
        total = sum(lacking.values())
        share = 1.0 if total <= room else room / total
        for slot, lack in lacking.items():
            self._amplitude[slot] += share * lack

    def _stay_under_onset(self) -> None:
        """Let vibration be strongest at the onset: the long window goes on hearing it for long."""
        if not self._followed or not self._struck_hops:
            return
        self._struck_hops -= 1
        over = self._felt() / max(TINY, self._struck)
        kept = max(self._design.struck_share, self._design.struck_grown * over)
        if kept < over:
            self._amplitude *= kept / over

    def _felt(self) -> float:
        """Return the strength of all that sounds at the end of the hop."""
        felt = self._amplitude * np.interp(self._hz, self._felt_hz, self._felt_weights)
        return float(np.sqrt((felt * felt)[self._alive].sum()))

    def fade(self, glides: Glides, hop: int) -> None:
        """Write one hop of `glides` in which every partial that sounds dies away."""
        self._begin_hop(glides, hop)
        self._amplitude[:] = 0.0
        self._alive[:] = False
        self._held.clear()
        self._struck_hops = 0
        self._finish_hop(glides, hop)

    def _begin_hop(self, glides: Glides, hop: int) -> None:
        glides.start_hz[hop] = self._hz
        glides.start_amplitude[hop] = self._amplitude
        glides.start_phase[hop] = self._phase
        self._start_sum = float(self._amplitude.sum())

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
        design = self._design
        alive = self._alive.nonzero()[0]
        if not hz.size:
            return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp), np.zeros(0)
        if not alive.size:
            return np.full(hz.size, -1), np.zeros(hz.size, dtype=np.intp), np.full(hz.size, np.inf)
        distance = np.abs(hz[:, None] - self._hz.take(alive)) + design.first_hz * np.arange(
            alive.size
        )
        nearest = distance.argmin(axis=1)
        gap_hz = distance.min(axis=1)
        slope_hz = self._mapping.scale_hz + self._mapping.scale_ratio * hz
        reach_hz = slope_hz * np.maximum(design.match_ratio, design.match_audio_hz / audio_hz)
        held = [slot in self._held for slot in alive.take(nearest)]
        if design.merge_ratio:
            reach_hz = np.maximum(reach_hz, design.merging_hz(hz))
        reach_hz = np.where(held, design.fresh_reach * reach_hz, reach_hz)
        mutual = distance.argmin(axis=0).take(nearest) == np.arange(hz.size)
        mutual &= gap_hz <= reach_hz
        beside = alive.take(nearest)
        return np.where(mutual, beside, -1), beside, gap_hz

    def _followed_share(self, relative_change: FloatArray) -> FloatArray:
        """Return the share of a change that is followed: all of a clear one, little of a jitter."""
        return np.minimum(1.0, self._design.steady_gain + relative_change * relative_change)

"""Partials that begin at an onset, tick by tick, until a hop takes them over."""

from typing import Any

import numpy as np

from tests.oracle.onsets import Onsets
from tests.oracle.partials import Begun, Partial, Partials, near_hz


class Fresh:
    """The partials of one voice that have begun of late, by slot; their `glides` by tick.
    estimate: from a tick and a group to Hz of vibration, weight and amplitude of what began."""

    def __init__(self, s: Any, partials: Partials, estimate: Any) -> None:
        self.s, self.partials, self.estimate = s, partials, estimate
        self.sounding: dict[int, Partial] = {}
        self.glides: list[tuple[float, ...]] = []

    def _begun(self):
        return [(slot, one, one.begun) for slot, one in sorted(self.sounding.items())]

    def _room(self):
        """Return what all amplitudes leave under the ceiling, which strength by loudness keeps."""
        if self.s.loudness_scale.size:
            return np.inf
        end_sum = sum(one.amplitude for one in self.partials.sounding.values())
        taken = sum(begun.goal for _, _, begun in self._begun())
        return max(0.0, self.s.ceiling - (max(self.partials.start_sum, end_sum) + taken))

    def start(self, tick: int, onsets: Onsets, ticks_left: int) -> None:
        """Start the partials of an onset. ticks_left: to the end of the hop that plays. Where the
        last onset is still measured, this one replaces it: its partials become these, in the middle
        of their vibration, and those left over end."""
        s = self.s
        young = [begun for _, _, begun in self._begun() if begun.age < s.heard_ticks]
        for begun in young:
            begun.goal = 0.0
        for group in onsets.groups(tick):
            hz, weight, amplitude = self.estimate(tick, group)
            reach = near_hz(s, hz)
            base = sum(one.amplitude for one in self.partials.near(hz))
            base += sum(begun.goal for _, one, begun in self._begun() if abs(one.hz - hz) < reach)
            goal = min(amplitude - base, self._room())
            if goal <= s.min_gain_share * amplitude:
                continue
            begun = Begun(group, goal, base, weight)
            if young:
                replaced = young.pop(0)
                begun.age, begun.joins = 1, replaced.joins
                vars(replaced).update(vars(begun))
            elif len(self.sounding) < s.onset_partials_max:
                slot = min(set(range(s.onset_partials_max)) - set(self.sounding))
                phase = s.start_phase
                if other := self.partials.strongest_near(hz):
                    hz, phase = other.hz, (other.phase - other.hz * ticks_left * s.tick_s) % 1.0
                    begun.joins = True
                self.sounding[slot] = Partial(hz, 0.0, phase, begun)
        for begun in young:
            begun.age = s.heard_ticks

    def play(self, tick: int, onsets: Onsets) -> None:
        """Write the glides of one tick; while the onset is still measured, improve them."""
        s, slots = self.s, self._begun()
        ends_hz = [self._improve(one, tick, onsets) for _, one, _ in slots]
        for (slot, one, begun), hz in zip(slots, ends_hz, strict=True):
            goal = begun.goal * float(s.rise_shares[min(begun.age, s.rise_shares.size - 1)])
            one.glide(self.glides, tick, 2 * self.partials.most + slot, hz, goal, s.tick_s)
            begun.age += 1
            if goal == 0.0 and begun.age > s.heard_ticks:
                del self.sounding[slot]

    def _improve(self, one, tick, onsets):
        """Let a goal follow what is known of its onset by now; return the new frequency."""
        begun, since = one.begun, tick - onsets.onset[tick]
        if not 0 < begun.age < self.s.heard_ticks or since >= self.s.heard_ticks:
            return one.hz
        hz, begun.weight, amplitude = self.estimate(tick, begun.group)
        wanted = amplitude - begun.base
        # Of a sound that is there already rounding leaves nothing, or next to nothing.
        if wanted < max(0.0, self.s.min_held_share * amplitude):
            wanted = 0.0
        begun.goal += min(wanted - begun.goal, self._room())
        return one.hz if begun.joins else hz

    def hand_over(self, tick: int, onsets: Onsets) -> None:
        """Hand over, at the end of a hop, those that are not improved any more."""
        for slot, one, begun in self._begun():
            if begun.age >= self.s.heard_ticks:
                begun.power, begun.hops = onsets.recent_power(tick, begun.group), self.s.hold_hops
                self.partials.adopt(one)
                del self.sounding[slot]

"""Partials born of an onset, on their own until the analysis knows what has begun."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.live.onsets import OnsetDetector
from audioflinger_hook.transform.live.partials import Held, PartialTracker
from audioflinger_hook.transform.live.synthesis import Glides, Smoother


@dataclass
class _OnsetPartial:
    group: tuple[int, int]
    hz: float
    phase: float
    amplitude: float
    goal: float
    base: float
    weight: float
    age: int
    joins: bool


class OnsetPartials:
    """At most `ONSET_PARTIALS_MAX` partials, tick by tick. Use from one thread at a time."""

    def __init__(
        self,
        design: LiveDesign,
        detector: OnsetDetector,
        smoother: Smoother,
        amplitude: Callable[[float, float, float], float],
    ) -> None:
        """amplitude: from (vibration frequency in Hz, weight, level of the onset)."""
        self._design = design.onsets
        self._rise_shares = design.onsets.rise_shares.tolist()
        self._emphasis = design.onsets.emphasis.tolist()
        self._worth_holding = design.tracking.worth_holding
        self._tick_s = design.grid.tick_s
        self._ceiling = design.synthesis.ceiling
        self._detector = detector
        self._amplitude = amplitude
        self._smoother = smoother
        self.slots = design.onsets.fresh_max
        self.reset()

    def reset(self) -> None:
        """Return to none."""
        self._sounding: list[_OnsetPartial | None] = [None] * self.slots

    @property
    def idle(self) -> bool:
        """Whether none sounds."""
        return not any(self._sounding)

    def start(self, tracker: PartialTracker, ticks_left: int) -> None:
        """Start the partials of the onset that the detector has found.

        Where the detector reports the last onset again, its partials become these, in the middle of
        their vibration, and those left over die. Where partials are merged, one that starts near
        to a partial of the tracker joins it: it has its frequency and its phase, so that both add
        up.
        ticks_left: to the end of the hop that the tracker has written last.
        """
        young = [one for one in self._sounding if one and one.age < self._design.heard_ticks]
        for one in young:
            one.goal = 0.0
        for group in self._detector.groups():
            hz, weight, amplitude = self._estimate(group)
            base = self._sounding_near(hz, tracker)
            lacking = min(amplitude - base, self._room(tracker))
            if lacking <= self._design.worth * amplitude:
                continue
            if young:
                one = young.pop(0)
                one.group, one.base, one.goal, one.age = group, base, lacking, 1
                one.weight = weight
                continue
            free = [slot for slot, one in enumerate(self._sounding) if one is None]
            if not free:
                break
            joined = tracker.strongest_near(hz, ticks_left * self._tick_s)
            hz, phase = joined or (hz, self._design.birth_phase)
            self._sounding[free[0]] = _OnsetPartial(
                group, hz, phase, 0.0, lacking, base, weight, 0, joined is not None
            )
        for one in young:
            one.age = self._design.heard_ticks

    def _sounding_near(self, hz: float, tracker: PartialTracker) -> float:
        near_hz = tracker.near_hz(hz)
        fresh = sum(one.goal for one in self._sounding if one and abs(one.hz - hz) < near_hz)
        return tracker.sounding_near(hz) + fresh

    def _estimate(self, group: tuple[int, int]) -> tuple[float, float, float]:
        hz, weight = self._detector.estimate(group)
        amplitude = self._amplitude(hz, weight, self._detector.level)
        return hz, weight, amplitude * float(self._smoother.compensation(np.array(hz)))

    def _room(self, tracker: PartialTracker) -> float:
        taken = tracker.loudest_sum + sum(one.goal for one in self._sounding if one)
        return max(0.0, self._ceiling - taken)

    def play(self, glides: Glides, tick: int, tracker: PartialTracker) -> None:
        """Write one tick of `glides`; while the detector still learns more, follow that.

        The first ticks of an onset are emphasised as far as there is room under full scale.
        """
        ends_hz = [self._follow(one, tracker) if one else 0.0 for one in self._sounding]
        room = self._room(tracker)
        for slot, one in enumerate(self._sounding):
            if one is None:
                continue
            hz = ends_hz[slot]
            goal = one.goal * self._rise_shares[min(one.age, len(self._rise_shares) - 1)]
            emphasis = self._emphasis[min(one.age, len(self._emphasis) - 1)]
            if emphasis > 1.0 and goal > 0.0:
                # All of an onset by the same factor.
                goal *= min(emphasis, self._ceiling / (self._ceiling - room))
            glides.start_hz[tick, slot], glides.end_hz[tick, slot] = one.hz, hz
            glides.start_amplitude[tick, slot] = one.amplitude
            glides.end_amplitude[tick, slot] = goal
            glides.start_phase[tick, slot] = one.phase
            phase = one.phase + 0.5 * self._tick_s * (one.hz + hz)
            one.phase = phase - float(np.floor(phase))
            one.hz, one.amplitude, one.age = hz, goal, one.age + 1
            if goal == 0.0 and one.age > self._design.heard_ticks:
                self._sounding[slot] = None

    def _follow(self, one: _OnsetPartial, tracker: PartialTracker) -> float:
        """Let a partial's goal follow what the detector has measured; return its new frequency."""
        if not (0 < one.age < self._design.heard_ticks and self._detector.is_measuring):
            return one.hz
        hz, one.weight, amplitude = self._estimate(one.group)
        wanted = amplitude - one.base
        # Of a sound that is there already rounding leaves nothing, or next to nothing.
        if wanted < self._worth_holding * amplitude or wanted < 0.0:
            wanted = 0.0
        one.goal += min(wanted - one.goal, self._room(tracker))
        return one.hz if one.joins else hz

    def hand_over(self, tracker: PartialTracker) -> None:
        """Hand those partials over to the tracker that the detector no longer improves."""
        for slot, one in enumerate(self._sounding):
            if one is not None and one.age >= self._design.heard_ticks:
                power = self._detector.recent_power(one.group)
                held = Held(one.goal + one.base, one.weight, one.group, power)
                tracker.adopt(one.hz, one.phase, one.amplitude, held)
                self._sounding[slot] = None

    def held_amplitude(self, held: Held) -> float:
        """Return the amplitude at which a partial is held, by the recent power of its bands."""
        if held.power <= 0.0:
            return 0.0
        share = self._detector.recent_power(held.group) / held.power
        return held.amplitude * float(np.sqrt(min(1.0, share)))

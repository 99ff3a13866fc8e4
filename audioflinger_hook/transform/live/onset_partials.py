"""Fresh partials: born of an onset, on their own until the analysis knows what has begun.

The first of a sound is felt by them. When they are old enough they go over to the tracker at the
end of a hop, in the middle of their vibration: the partial that the long window finds there glides
on from where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.live.onsets import HEARD_TICKS, ONSET_PARTIALS_MAX, OnsetDetector
from audioflinger_hook.transform.live.partials import WORTH_HOLDING, Glides, Held, PartialTracker
from audioflinger_hook.transform.live.synthesis import Smoother

RISE = (0.4, 1.0)
"""Share of its amplitude that a fresh partial reaches in its first tick, and in its second."""

WORTH = 0.25
"""Where less than this share lacks, nothing is born."""

BIRTH_PHASE = 0.75
"""Phase at birth in cycles: a sine, whose first swing is felt at once."""


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


class OnsetPartials:
    """At most `ONSET_PARTIALS_MAX` partials, tick by tick. Held by one thread at a time."""

    delay_ticks = len(RISE) - sum(RISE) + 0.5 * RISE[-1]
    """How late an amplitude follows on average, in ticks: each glides from share to share."""

    def __init__(
        self,
        detector: OnsetDetector,
        smoother: Smoother,
        tick_s: float,
        ceiling: float,
        gain: Callable[[float, float], float],
    ) -> None:
        """gain: of (vibration frequency in Hz, level of what begins), to a factor on amplitudes."""
        self._detector = detector
        self._gain = gain
        self._smoother = smoother
        self._tick_s = tick_s
        self._ceiling = ceiling
        self.slots = ONSET_PARTIALS_MAX
        self.reset()

    def reset(self) -> None:
        """Return to none."""
        self._sounding: list[_OnsetPartial | None] = [None] * self.slots

    @property
    def idle(self) -> bool:
        """Whether none sounds."""
        return not any(self._sounding)

    def bear(self, tracker: PartialTracker) -> None:
        """Let what the detector has heard begin begin.

        Where the last onset is told anew, its partials become these, in the middle of their
        vibration, and those too many die.
        """
        young = [one for one in self._sounding if one and one.age < HEARD_TICKS]
        for one in young:
            one.goal = 0.0
        for group in self._detector.groups():
            hz, weight, amplitude = self._told(group)
            base = self._sounding_near(hz, tracker)
            lacking = min(amplitude - base, self._room(tracker))
            if lacking <= WORTH * amplitude:
                continue
            if young:
                one = young.pop(0)
                one.group, one.base, one.goal, one.age = group, base, lacking, 1
                one.weight = weight
                continue
            free = [slot for slot, one in enumerate(self._sounding) if one is None]
            if not free:
                break
            self._sounding[free[0]] = _OnsetPartial(
                group, hz, BIRTH_PHASE, 0.0, lacking, base, weight, 0
            )
        for one in young:
            one.age = HEARD_TICKS

    def _sounding_near(self, hz: float, tracker: PartialTracker) -> float:
        near_hz = tracker.near_hz(hz)
        fresh = sum(one.goal for one in self._sounding if one and abs(one.hz - hz) < near_hz)
        return tracker.sounding_near(hz) + fresh

    def _told(self, group: tuple[int, int]) -> tuple[float, float, float]:
        hz, weight = self._detector.told(group)
        level = self._detector.level
        amplitude = weight * level * self._gain(hz, level)
        return hz, weight, amplitude * float(self._smoother.compensation(np.array(hz)))

    def _room(self, tracker: PartialTracker) -> float:
        taken = tracker.loudest_sum + sum(one.goal for one in self._sounding if one)
        return max(0.0, self._ceiling - taken)

    def play(self, glides: Glides, tick: int, tracker: PartialTracker) -> None:
        """Write one tick of `glides`; while the detector is still told more, follow that."""
        for slot, one in enumerate(self._sounding):
            if one is None:
                continue
            hz = one.hz
            if 0 < one.age < HEARD_TICKS and self._detector.still_told:
                hz, one.weight, amplitude = self._told(one.group)
                wanted = amplitude - one.base
                # Of a sound that is there already rounding leaves nothing, or next to nothing.
                if wanted < WORTH_HOLDING * amplitude or wanted < 0.0:
                    wanted = 0.0
                one.goal += min(wanted - one.goal, self._room(tracker))
            goal = one.goal * RISE[min(one.age, len(RISE) - 1)]
            glides.start_hz[tick, slot], glides.end_hz[tick, slot] = one.hz, hz
            glides.start_amplitude[tick, slot] = one.amplitude
            glides.end_amplitude[tick, slot] = goal
            glides.start_phase[tick, slot] = one.phase
            phase = one.phase + 0.5 * self._tick_s * (one.hz + hz)
            one.phase = phase - float(np.floor(phase))
            one.hz, one.amplitude, one.age = hz, goal, one.age + 1
            if goal == 0.0 and one.age > HEARD_TICKS:
                self._sounding[slot] = None

    def hand_over(self, tracker: PartialTracker) -> None:
        """Let those that are told as well as they can be go over to the tracker."""
        for slot, one in enumerate(self._sounding):
            if one is not None and one.age >= HEARD_TICKS:
                loudness = self._detector.loudness(one.group)
                held = Held(one.goal + one.base, one.weight, one.group, loudness)
                tracker.adopt(one.hz, one.phase, one.amplitude, held)
                self._sounding[slot] = None

    def still_heard(self, held: Held) -> float:
        """Return the amplitude at which a partial is to be held, by what its bands have of late."""
        if held.loudness <= 0.0:
            return 0.0
        share = self._detector.loudness(held.group) / held.loudness
        return held.amplitude * float(np.sqrt(min(1.0, share)))

"""When a frame counter really stood where: callback times without their jitter."""

from __future__ import annotations

import math
from typing import NamedTuple

BANDWIDTH_HZ = 0.1
SETTLED_S = 0.1
MAX_DEVIATION = 2_000e-6
"""How far a sound card's rate may lie from nominal; what looks like more is jitter."""

STALLED_S = 0.25
"""A callback later than this: frames were lost, the line of time begins anew."""
EARLY_S = 0.03
"""A callback earlier than this: a backlog is delivered; what was learned before it is wrong."""
ASTRAY_S = 0.3
"""Outliers to one side for this long are no outliers: the counter has made a jump."""

_OUTLIER = 6.0
_FIRST_SPREAD_S = 0.005
_LEAST_SPREAD_S = 50e-6
_FIRST_TIME_S = 0.25
_SPREAD_TIME_S = 5.0


class ClockReading(NamedTuple):
    """A straight line through a counter and time; any thread may use it, it never changes.

    time_s: when the counter stood at `frames`; frames_per_s: its pace; settled: enough callbacks
    have been seen to rely on it; astray: the last one was an outlier, perhaps of a new line.
    """

    time_s: float
    frames: int
    frames_per_s: float
    settled: bool
    astray: bool

    def frames_at(self, time_s: float) -> float:
        """The counter at a time near the last callback, in frames and fractions."""
        return self.frames + (time_s - self.time_s) * self.frames_per_s

    def time_of(self, frames: float) -> float:
        """The time in seconds at which the counter stands, stood or will stand at `frames`."""
        return self.time_s + (frames - self.frames) / self.frames_per_s


class FrameClock:
    """Smoothed times of the callbacks of one stream: a second-order delay-locked loop.

    samplerate: nominal, Hz; bandwidth_hz: of the loop, once it has settled. One thread, the
    stream's own, calls `update`; the reading it returns may go anywhere.

    F. Adriaensen, "Using a DLL to filter time" (2005), with steps in proportion to the frames of
    each callback, so that these may vary. Until the loop's own bandwidth is reached, 4.5 s after
    a start, it is that of a line fitted to all callbacks so far (gains 4/k, 8/k²). Lateness far
    beyond the usual (six times its mean) is cut: a paused thread says nothing about the clock.
    Lost frames, a backlog or a restarted stream begin a new line; the pace learned is kept.

    reading: the last `ClockReading`; None before the first callback.
    restarts: lines begun since the start, the first one not counted.
    """

    def __init__(self, samplerate: float, bandwidth_hz: float = BANDWIDTH_HZ) -> None:
        self._nominal_s = 1.0 / samplerate
        self._omega = 2.0 * math.pi * bandwidth_hz
        self._period_s = self._nominal_s
        self._spread_s = _FIRST_SPREAD_S
        self._age_s = self._astray_s = self._begun_s = 0.0
        self.reading: ClockReading | None = None
        self.restarts = 0

    def update(self, now_s: float, frames: int) -> ClockReading | None:
        """Take one callback: the counter stood at `frames` at about `now_s`; returns `reading`.

        A time that is not finite, or a counter that did not move, changes nothing.
        """
        if not math.isfinite(now_s):
            return self.reading
        reading = self.reading
        if reading is None:
            return self._begin(now_s, frames)
        moved = frames - reading.frames
        if moved == 0:
            return reading
        expected_s = reading.time_s + moved * self._period_s
        late_s = now_s - expected_s
        if moved < 0 or late_s > STALLED_S or late_s < -EARLY_S:
            return self._begin(now_s, frames)
        seconds = moved * self._nominal_s
        limit_s = _OUTLIER * self._spread_s
        outlier = abs(late_s) > limit_s
        self._astray_s = self._counted_astray(late_s, seconds) if outlier else 0.0
        if abs(self._astray_s) > ASTRAY_S:
            return self._begin(now_s, frames)
        late_s = max(-limit_s, min(limit_s, late_s))
        if abs(self._astray_s) <= seconds:  # not on and on: what goes astray is not the usual
            share = min(1.0, seconds / min(_SPREAD_TIME_S, _FIRST_TIME_S + self._age_s))
            self._spread_s += share * (abs(late_s) - self._spread_s)
            self._spread_s = max(self._spread_s, _LEAST_SPREAD_S)
        self._age_s += seconds
        step = seconds * max(self._omega, 2.0 * math.sqrt(2.0) / self._age_s)
        proportional = min(1.0, math.sqrt(2.0) * step)
        self._period_s += 0.5 * proportional**2 * late_s / moved
        lowest = self._nominal_s * (1.0 - MAX_DEVIATION)
        highest = self._nominal_s * (1.0 + MAX_DEVIATION)
        self._period_s = max(lowest, min(highest, self._period_s))
        return self._read(expected_s + proportional * late_s, frames, now_s)

    def _counted_astray(self, late_s: float, seconds: float) -> float:
        """Seconds of outliers in a row, counted with the sign of their side."""
        side = math.copysign(1.0, late_s)
        return side * seconds + (self._astray_s if self._astray_s * side > 0.0 else 0.0)

    def _begin(self, now_s: float, frames: int) -> ClockReading:
        self._begun_s = now_s
        self._age_s = 0.0
        self._astray_s = 0.0
        self._spread_s = _FIRST_SPREAD_S
        self.restarts += self.reading is not None
        return self._read(now_s, frames, now_s)

    def _read(self, time_s: float, frames: int, now_s: float) -> ClockReading:
        settled = self._age_s >= SETTLED_S and now_s - self._begun_s >= SETTLED_S
        self.reading = ClockReading(
            time_s, frames, 1.0 / self._period_s, settled, self._astray_s != 0.0
        )
        return self.reading

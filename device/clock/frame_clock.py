"""A stream's true clock: callback times without their lateness."""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import NamedTuple

WINDOW_S = 60.0  # how long callbacks are considered: several times the slowest beat between blocks
BUCKET_S = 0.5  # only the earliest callback of each such interval is kept
SETTLED_S = 0.1
PREFILL_S = 0.06  # a new stream fills its buffers at once: these early callbacks are no clock
MAX_DEVIATION = 2_000e-6  # of a sound card's rate from nominal; anything more is jitter
STALLED_S = 0.25  # a callback later than this means lost frames: the line starts again
EARLY_S = 0.03  # a callback earlier than this delivers a backlog: the line before it was wrong
ASTRAY_S = 0.3  # callbacks that are outliers for this long mean a jump of the counter
STRANDED_S = 2.0  # no callback near the line for this long: a single one came too early
STRANDED_BLOCKS = 1.5  # what is not near, in blocks; beats between blocks stay within one
ALERT_S = 0.5  # for this long after `expect_jump` a single outlier means a jump

_OUTLIER = 6.0
_FIRST_SPREAD_S = 0.005
_LEAST_SPREAD_S = 150e-6
_FIRST_TIME_S = 0.25
_SPREAD_TIME_S = 5.0
_USUAL_DRIFT = 150e-6
_LEARNED_DRIFT = 10e-6
_LEAST_NOISE_S = 5e-6


class ClockReading(NamedTuple):
    """A straight line through a counter and time.

    time_s: the earliest time at which the counter can have reached `frames`. settled: enough
    callbacks were seen to rely on it. astray: the last one was an outlier, perhaps of a new line.
    stepped_s: how far corrections have moved the line to later times so far.
    """

    time_s: float
    frames: int
    frames_per_s: float
    settled: bool
    astray: bool
    stepped_s: float

    def frames_at(self, time_s: float) -> float:
        """Return the counter at a time near the last callback."""
        return self.frames + (time_s - self.time_s) * self.frames_per_s

    def time_of(self, frames: float) -> float:
        """Return the time at which the counter reaches `frames`."""
        return self.time_s + (frames - self.frames) / self.frames_per_s


class FrameClock:
    """The line under a stream's callbacks: its clock.

    A callback can only be late: the machine is busy, or the server's blocks are no multiple of the
    stream's, which beats over minutes. So the line lies under all callbacks of the last minute: it
    is the middle edge of the lower convex hull of (counter, lateness). S. Moon, P. Skelly,
    D. Towsley, "Estimation and removal of clock skew from network delay measurements" (INFOCOM
    1999). As far as the callbacks leave it open, the previous rate holds.

    Lost frames, a backlog or a restarted stream start a new line and keep the rate. So does a line
    that no callback comes near any more: it is stranded.

    samplerate: nominal, Hz. block_frames: of a usual callback. reading: None before the first
    callback; any thread may use it. restarts: lines after the first one. strandings: stranded ones.
    Only the stream's own thread calls the methods.
    """

    def __init__(self, samplerate: float, block_frames: int = 256) -> None:
        self._nominal_s = 1.0 / samplerate
        self._near_s = STRANDED_BLOCKS * block_frames / samplerate
        # The line starts at counter _frames and time _time_s.
        # Points are (seconds of the counter since then, seconds later than nominal).
        self._deviation = self._known_deviation = 0.0
        self._drift = _USUAL_DRIFT
        self._points: deque[tuple[float, float]] = deque()
        self._best: tuple[float, float] | None = None
        self._time_s = self._offset_s = self._fallen_s = self._bucket_s = self._usual_s = 0.0
        self._frames, self._spread_s = 0, _FIRST_SPREAD_S
        self._astray_s = self._stranded_s = 0.0
        self._begun_s = self._age_s = self._alert_s = self._stepped_s = 0.0
        self._filling = True
        self.reading: ClockReading | None = None
        self.restarts = self.strandings = 0

    def expect_jump(self) -> None:
        """Announce that frames may be lost."""
        self._alert_s = ALERT_S

    def update(self, now_s: float, frames: int) -> ClockReading | None:
        """Take a callback at time now_s, with the counter at `frames`; returns `reading`.

        A time that is not finite, or an unchanged counter, changes nothing.
        """
        reading = self.reading
        if not math.isfinite(now_s):
            return reading
        if reading is None:
            return self._begin(now_s, frames)
        if frames == reading.frames:
            return reading
        counted_s = (frames - self._frames) * self._nominal_s
        later_s = now_s - self._time_s - counted_s
        late_s = later_s - self._offset_s - self._deviation * counted_s
        early_s = self._fallen_s - late_s
        if frames < reading.frames or late_s > STALLED_S or early_s > EARLY_S:
            return self._begin(now_s, frames)
        seconds = (frames - reading.frames) * self._nominal_s
        outlier = late_s > self._usual_s + _OUTLIER * self._spread_s
        self._astray_s = self._astray_s + seconds if outlier else 0.0
        if self._astray_s > (0.0 if self._alert_s > 0.0 else ASTRAY_S):
            return self._begin(now_s, frames)
        self._stranded_s = self._stranded_s + seconds if late_s > self._near_s else 0.0
        if self._stranded_s > STRANDED_S:
            self.strandings += 1
            return self._begin(now_s, frames)
        self._alert_s -= seconds
        self._age_s += seconds
        if self._filling and min(self._age_s, now_s - self._begun_s) > PREFILL_S:
            self._filling = False
            self._forget(now_s, frames, self._spread_s)
            return self._read(frames, now_s, another_line=True)
        if not outlier:  # persistent lateness must not become the usual one
            share = min(1.0, seconds / min(_SPREAD_TIME_S, _FIRST_TIME_S + self._age_s))
            self._spread_s += share * (abs(late_s - self._usual_s) - self._spread_s)
            self._spread_s = max(self._spread_s, _LEAST_SPREAD_S)
            self._usual_s += share * (late_s - self._usual_s)
        if late_s < 0.0:
            self._offset_s += late_s
            self._fallen_s -= late_s
            self._usual_s -= late_s
        if self._best is None or later_s - self._best[1] < self._deviation * (
            counted_s - self._best[0]
        ):
            self._best = (counted_s, later_s)
        if counted_s - self._bucket_s >= BUCKET_S and not self._filling:
            self._fit(counted_s)
        return self._read(frames, now_s)

    def _begin(self, now_s: float, frames: int) -> ClockReading:
        self.restarts += self.reading is not None
        self._begun_s, self._age_s, self._filling = now_s, 0.0, True
        self._known_deviation = self._deviation  # the rate outlives the line
        self._forget(now_s, frames, _FIRST_SPREAD_S)
        return self._read(frames, now_s, another_line=True)

    def _forget(self, now_s: float, frames: int, spread_s: float) -> None:
        self._time_s, self._frames, self._spread_s = now_s, frames, spread_s
        self._offset_s = self._fallen_s = self._usual_s = 0.0
        self._astray_s = self._stranded_s = self._bucket_s = 0.0
        self._points.clear()
        self._best = (0.0, 0.0)

    def _fit(self, counted_s: float) -> None:
        """Fit the line to the earliest callbacks of the last minute."""
        points = self._points
        assert self._best is not None
        points.append(self._best)
        self._best = None
        self._bucket_s = counted_s
        self._fallen_s = 0.0
        while points[0][0] < counted_s - WINDOW_S:
            points.popleft()
        first_s, last_s = points[0][0], points[-1][0]
        slope = _middle_slope(points)
        if slope is not None:
            at = [later_s - slope * point_s for point_s, later_s in points]
            noise_s = sum(at) / len(at) - min(at) + _LEAST_NOISE_S
            drift_s = self._drift * (last_s - first_s)
            trust = drift_s**2 / (drift_s**2 + noise_s**2)
            deviation = self._known_deviation + trust * (slope - self._known_deviation)
            self._deviation = max(-MAX_DEVIATION, min(MAX_DEVIATION, deviation))
            if last_s - first_s > 0.9 * WINDOW_S:
                self._known_deviation = self._deviation
                self._drift = _LEARNED_DRIFT + math.sqrt(1.0 - trust) * _USUAL_DRIFT
        self._offset_s = min(later_s - self._deviation * point_s for point_s, later_s in points)

    def _read(self, frames: int, now_s: float, *, another_line: bool = False) -> ClockReading:
        settled = self._age_s >= SETTLED_S and now_s - self._begun_s >= SETTLED_S
        period_s = self._nominal_s * (1.0 + self._deviation)
        time_s = self._time_s + self._offset_s + (frames - self._frames) * period_s
        if self.reading is not None and not another_line:
            self._stepped_s += time_s - self.reading.time_of(frames)
        astray = self._astray_s != 0.0
        reading = ClockReading(time_s, frames, 1.0 / period_s, settled, astray, self._stepped_s)
        self.reading = reading
        return reading


def _middle_slope(points: deque[tuple[float, float]]) -> float | None:
    """Return the slope of the lower convex hull's edge under the mean of the points."""
    hull: list[tuple[float, float]] = []
    total = 0.0
    for x, y in points:
        total += x
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                break
            hull.pop()
        hull.append((x, y))
    mean = total / len(points)
    for (x0, y0), (x1, y1) in itertools.pairwise(hull):
        if x0 <= mean <= x1 and x1 > x0:
            return (y1 - y0) / (x1 - x0)
    return None

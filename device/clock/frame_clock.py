"""A stream's true clock, estimated from the times of its callbacks."""

import itertools
import math
from collections import deque
from typing import NamedTuple

WINDOW_S = 60.0  # length of the evaluated history
BUCKET_S = 0.5  # only the earliest callback of each such interval is kept
SETTLED_S = 0.1
PREFILL_S = 0.06  # a new stream fills its buffers at once: these early callbacks are ignored
MAX_DEVIATION = 2_000e-6  # of a sound card's rate from nominal; a larger deviation is jitter
STALLED_S = 0.25  # a callback later than this means lost frames: a new line starts
EARLY_S = 0.03  # a callback earlier than this delivers a backlog: the previous line was wrong
ASTRAY_S = 0.3  # if callbacks are outliers for this long, the counter has jumped
STRANDED_S = 2.0  # if no callback is near the line for this long, the line is too early
STRANDED_BLOCKS = 1.5  # largest distance of a near callback; periodic lateness stays within 1 block
ALERT_S = 0.5  # for this long after `expect_jump`, a single outlier means a jump

_OUTLIER = 6.0
_FIRST_SPREAD_S, _LEAST_SPREAD_S = 0.005, 150e-6
_FIRST_TIME_S, _SPREAD_TIME_S = 0.25, 5.0
_USUAL_DRIFT, _LEARNED_DRIFT = 150e-6, 10e-6
_LEAST_NOISE_S = 5e-6


class ClockReading(NamedTuple):
    """A linear relation between a frame counter and time.

    time_s: the earliest time at which the counter can have reached `frames`. settled: whether
    callbacks were seen for 0.1 s. astray: whether the last callback was an outlier. stepped_s: the
    sum of all corrections of time_s, in s; positive if they made it later.
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
    """The clock of a stream: a line in the plot of callback times over the frame counter.

    A callback can be late, for example on a busy machine, but never early. If the server's block is
    not a multiple of the stream's block, the lateness varies periodically. The line therefore lies
    under the callbacks of the last minute: it is the middle edge of their lower convex hull.
    Source: S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay
    measurements" (INFOCOM 1999). With few or noisy callbacks, the previous rate has more weight.

    After lost frames, a backlog or a restart of the stream, a new line with the same rate begins.
    If no callback has been near the line for 2 s, the line is called stranded; a new one begins.
    samplerate: nominal, Hz. block_frames: usual frames per callback. reading: the present line,
    None before the first callback; any thread may use it. restarts: number of lines after the
    first. strandings: number of stranded lines. Only the stream's own thread calls the methods.
    """

    def __init__(self, samplerate: float, block_frames: int = 256) -> None:
        self._nominal_s = 1.0 / samplerate
        self._near_s = STRANDED_BLOCKS * block_frames / samplerate
        # The line starts at counter _frames and time _time_s.
        # Points are (counter in s since the start, lateness in s relative to the nominal rate).
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
        """Announce that the counter may jump soon because of lost frames."""
        self._alert_s = ALERT_S

    def update(self, now_s: float, frames: int) -> ClockReading | None:
        """Process a callback at now_s, with the counter at `frames`; return `reading`."""
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
        if frames < reading.frames or late_s > STALLED_S or self._fallen_s - late_s > EARLY_S:
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
        if not outlier:  # persistent outliers must not raise the usual lateness
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
        self._known_deviation = self._deviation  # the new line keeps the rate
        self._forget(now_s, frames, _FIRST_SPREAD_S)
        return self._read(frames, now_s, another_line=True)

    def _forget(self, now_s: float, frames: int, spread_s: float) -> None:
        self._time_s, self._frames, self._spread_s = now_s, frames, spread_s
        self._offset_s = self._fallen_s = self._usual_s = 0.0
        self._astray_s = self._stranded_s = self._bucket_s = 0.0
        self._points.clear()
        self._best = (0.0, 0.0)

    def _fit(self, counted_s: float) -> None:
        """Fit the line to the earliest callback of each 0.5 s in the last minute."""
        points = self._points
        assert self._best is not None
        points.append(self._best)
        self._best = None
        self._bucket_s = counted_s
        self._fallen_s = 0.0
        while points[0][0] < counted_s - WINDOW_S:
            points.popleft()
        first_s, last_s = points[0][0], points[-1][0]
        if (slope := _middle_slope(points)) is not None:
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
        known = settled, self._astray_s != 0.0, self._stepped_s
        self.reading = ClockReading(time_s, frames, 1.0 / period_s, *known)
        return self.reading


def _middle_slope(points: deque[tuple[float, float]]) -> float | None:
    """Return the slope of the points' lower convex hull at their mean x; None for one point."""
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

"""When one stream's frames are due, and how late its callbacks come: what each side keeps."""

from __future__ import annotations

import bisect
import math
from itertools import accumulate

from device.clock.frame_clock import ClockReading, FrameClock


class StreamTiming:
    """The clock of one stream, and the lateness that is measured against it.

    samplerate: nominal, Hz; block_frames: of a usual callback; lateness_limit_s: see `Lateness`.
    For the stream's own thread; others may use what it returns.
    """

    def __init__(self, samplerate: float, block_frames: int, lateness_limit_s: float) -> None:
        self._clock = FrameClock(samplerate, block_frames)
        self._lateness = Lateness(lateness_limit_s)

    @property
    def lateness_s(self) -> float:
        """What to provide for, see `Lateness`."""
        return self._lateness.estimate_s

    @property
    def known(self) -> bool:
        """Whether the lateness was looked at yet."""
        return self._lateness.known

    def expect_jump(self) -> None:
        """See `FrameClock`."""
        self._clock.expect_jump()

    def update(self, now_s: float, frames: int) -> ClockReading | None:
        """See `FrameClock`; lateness against a line that was wrong all the time is forgotten."""
        strandings = self._clock.strandings
        reading = self._clock.update(now_s, frames)
        if self._clock.strandings != strandings:
            self._lateness.forget()
        return reading

    def add_lateness(self, late_s: float, seconds: float, clock: ClockReading) -> None:
        """Take how late a callback was, `seconds` of its stream after the last one."""
        if not clock.settled:
            self._lateness.forget_pause()
        elif math.isfinite(late_s):
            self._lateness.add(late_s, seconds, clock.astray)


SHARE = 0.001
"""Of all callbacks, those that may come later than the estimate."""
LEAST_S = 0.0005

_BIN_S = 0.0001
_HALF_LIFE_S = 60.0
_EVERY_S = 0.5
_RISE_S = 0.0001
_FALL_S = 0.001
_HEAVIEST = 1e12


class Lateness:
    """The 99.9th percentile of lateness over the last minutes, in steps of 0.1 ms.

    limit_s: the most to provide for; what comes later than that is left to run out. Called by
    the thread whose callbacks are measured. A histogram whose entries lose half their weight in
    60 s; looked at every 0.5 s. Below 1000 callbacks it is the latest one. All callbacks that one
    pause has made late count as one, the latest; if they turn out to be no lateness, as the
    counter made a jump, they do not count at all.

    estimate_s: 0.5 ms to `limit_s`. It follows every rise, but a fall only by more than 1 ms, so
    that it rests. known: whether it was looked at yet. Any thread may read them.
    """

    def __init__(self, limit_s: float) -> None:
        bins = max(1, round(limit_s / _BIN_S))
        self._limit_s = limit_s
        self._counts = [0.0] * (bins + 1)
        self._weight = 1.0
        self._unseen_s = 0.0
        self._paused_s = 0.0
        self.estimate_s = min(LEAST_S, limit_s)
        self.known = False

    def add(self, late_s: float, seconds: float, paused: bool) -> None:
        """Take one callback that was `late_s` late, `seconds` of its stream after the last.

        paused: it is one of several in the wake of one pause, and more may come.
        """
        if paused:
            self._paused_s = max(self._paused_s, late_s)
            return
        if self._paused_s:
            self._count(self._paused_s)
            self._paused_s = 0.0
        self._count(late_s)
        # The newest weighs more and more, in place of all others weighing less.
        self._weight *= 2.0 ** min(1.0, seconds / _HALF_LIFE_S)
        if self._weight > _HEAVIEST:
            self._counts = [count / self._weight for count in self._counts]
            self._weight = 1.0
        self._unseen_s += seconds
        if self._unseen_s >= _EVERY_S:
            self._unseen_s = 0.0
            self._look()

    def forget(self) -> None:
        """Begin anew: what was added was no lateness. It is the least until the next look."""
        self._counts = [0.0] * len(self._counts)
        self._weight = 1.0
        self._paused_s = 0.0
        self.estimate_s = min(LEAST_S, self._limit_s)

    def forget_pause(self) -> None:
        """Let the last pause not count: the stream began anew."""
        self._paused_s = 0.0

    def _count(self, late_s: float) -> None:
        last = len(self._counts) - 1
        self._counts[min(last, max(0, int(late_s / _BIN_S)))] += self._weight

    def _look(self) -> None:
        self.known = True
        from_latest = list(accumulate(reversed(self._counts)))
        beyond = bisect.bisect_right(from_latest, SHARE * from_latest[-1])
        upper_edge_s = (len(self._counts) - beyond) * _BIN_S
        late_s = min(self._limit_s, max(LEAST_S, upper_edge_s))
        if late_s > self.estimate_s + _RISE_S or late_s < self.estimate_s - _FALL_S:
            self.estimate_s = late_s

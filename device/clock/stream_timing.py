"""The clock of one stream, and how late its callbacks come."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

from device.clock.frame_clock import STALLED_S, ClockReading, FrameClock

SHARE = 0.001  # the share of callbacks that may come later than the estimate
LEAST_S = 0.0005

_BIN_S = 0.0001
_HALF_LIFE_S = 60.0
_EVERY_S = 0.5
_RISE_S = 0.0001
_FALL_S = 0.001
_HEAVIEST = 1e12


class StreamTiming:
    """A stream's clock, and the lateness measured against it. For the stream's own thread.

    See `FrameClock` and `Lateness`.
    """

    def __init__(self, samplerate: float, block_frames: int, lateness_limit_s: float) -> None:
        self._clock = FrameClock(samplerate, block_frames)
        self.lateness = Lateness(lateness_limit_s)
        self.expect_jump = self._clock.expect_jump

    def update(self, now_s: float, frames: int) -> ClockReading | None:
        """Update the clock; lateness against a stranded line is forgotten."""
        strandings = self._clock.strandings
        reading = self._clock.update(now_s, frames)
        if self._clock.strandings != strandings:
            self.lateness.forget()
        return reading

    def add_lateness(self, late_s: float, seconds: float, clock: ClockReading) -> None:
        """Count a callback that was late_s late, `seconds` of its stream after the previous."""
        if not clock.settled:
            self.lateness.paused_s = 0.0  # the stream started again
        elif math.isfinite(late_s):
            self.lateness.add(late_s, seconds, clock.astray)


class Written(NamedTuple):
    """What the writing side publishes for the reading one.

    frames: count written so far, as of `clock`. run_start: the first frame after the last stall;
    earlier ones are not played after it.
    """

    frames: int
    clock: ClockReading
    run_start: int
    lateness_s: float
    lateness_known: bool


class WriteTiming:
    """The timing of the writing side, from the times of capture.

    The writing thread calls `add`; any thread may call the rest. written: None until a frame's
    capture time is known.
    """

    def __init__(self, samplerate: float, block_frames: int, lateness_limit_s: float) -> None:
        self._samplerate = samplerate
        self._block_s = block_frames / samplerate
        self._timing = StreamTiming(samplerate, block_frames, lateness_limit_s)
        self._last_s = -math.inf
        self._jump_wanted = self._jump_expected = object()
        self.written: Written | None = None

    def expect_jump(self) -> None:
        """Announce that the source is about to change, with a gap before the next frames."""
        self._jump_wanted = object()

    def add(
        self, frames: int, end: int, now_s: float, earlier: Sequence[tuple[float, int]]
    ) -> None:
        """Take the times of the last `frames`, up to count `end`; see `DelayLine.write`."""
        first_s = earlier[0][0] if earlier else now_s
        stalled = not first_s - self._last_s < STALLED_S
        if math.isfinite(now_s):
            self._last_s = now_s
        if self._jump_wanted is not self._jump_expected:
            self._jump_expected = self._jump_wanted
            self._timing.expect_jump()
        start = part = end - frames
        clock = None
        for part_s, frames_by_then in (*earlier, (now_s, frames)):
            part_end = start + frames_by_then
            if clock := self._timing.update(part_s, part_end):
                # how far the captured frames lagged behind the clock just before these arrived
                late_s = part_s - clock.time_of(part) - self._block_s
                self._timing.add_lateness(late_s, (part_end - part) / self._samplerate, clock)
            part = part_end
        if clock is None:  # no time has been finite so far
            return
        before, lateness = self.written, self._timing.lateness
        run_start = start if stalled or before is None else before.run_start
        self.written = Written(end, clock, run_start, lateness.estimate_s, lateness.known)


class Lateness:
    """The 99.9th percentile of lateness over the last minutes, in steps of 0.1 ms.

    With fewer than 1000 callbacks it is the greatest lateness. All callbacks that one pause delays
    count as one, the latest. A pause that turns out to be a jump of the counter does not count.

    limit_s: the most to provide for; later callbacks cause an underflow. estimate_s: 0.5 ms to
    `limit_s`, which follows every rise, but a fall only if greater than 1 ms. known: whether it has
    been evaluated. paused_s: greatest lateness of the present pause, 0 for none. Any thread may
    read these; one thread calls the methods.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._counts = [0.0] * (max(1, round(limit_s / _BIN_S)) + 1)
        self._unseen_s = self.paused_s = 0.0
        self._weight, self.estimate_s = 1.0, min(LEAST_S, limit_s)
        self.known = False

    def add(self, late_s: float, seconds: float, paused: bool) -> None:
        """Count one callback; paused: it is one of several after the same pause."""
        if paused:
            self.paused_s = max(self.paused_s, late_s)
            return
        if self.paused_s:
            self._count(self.paused_s)
            self.paused_s = 0.0
        self._count(late_s)
        # Newer entries gain weight instead of all older ones losing it.
        self._weight *= 2.0 ** min(1.0, seconds / _HALF_LIFE_S)
        if self._weight > _HEAVIEST:
            self._counts = [count / self._weight for count in self._counts]
            self._weight = 1.0
        self._unseen_s += seconds
        if self._unseen_s >= _EVERY_S:
            self._unseen_s = 0.0
            self._evaluate()

    def forget(self) -> None:
        """Drop all entries, which were no lateness."""
        self._counts = [0.0] * len(self._counts)
        self._weight = 1.0
        self.paused_s = 0.0
        self.estimate_s = min(LEAST_S, self._limit_s)

    def _count(self, late_s: float) -> None:
        last = len(self._counts) - 1
        self._counts[min(last, max(0, int(late_s / _BIN_S)))] += self._weight

    def _evaluate(self) -> None:
        self.known = True
        from_latest = list(accumulate(reversed(self._counts)))
        beyond = bisect.bisect_right(from_latest, SHARE * from_latest[-1])
        upper_edge_s = (len(self._counts) - beyond) * _BIN_S
        late_s = min(self._limit_s, max(LEAST_S, upper_edge_s))
        if late_s > self.estimate_s + _RISE_S or late_s < self.estimate_s - _FALL_S:
            self.estimate_s = late_s

"""The clock of one stream, and the lateness of its callbacks."""

import bisect
import math
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

from device.clock.frame_clock import STALLED_S, ClockReading, FrameClock

SHARE = 0.001  # share of callbacks that may be later than the estimate
LEAST_S = 0.0005
LATENESS_LIMIT_S = 0.03  # largest estimate per side; later callbacks may cause underflows

Part = tuple[float, int]  # time of capture of a part; frames of the block up to the part's end

_BIN_S, _RISE_S, _FALL_S = 0.0001, 0.0001, 0.001
_HALF_LIFE_S, _EVERY_S = 60.0, 0.5
_HEAVIEST = 1e12


class StreamTiming:
    """A `FrameClock`, and the `Lateness` relative to it. Only the stream's thread uses it."""

    def __init__(self, samplerate: float, block_frames: int) -> None:
        self._clock = FrameClock(samplerate, block_frames)
        self.lateness = Lateness(LATENESS_LIMIT_S)
        self.expect_jump = self._clock.expect_jump

    def update(self, now_s: float, frames: int) -> ClockReading | None:
        """Update the clock, see `FrameClock.update`; after a stranded line, forget the lateness."""
        strandings = self._clock.strandings
        reading = self._clock.update(now_s, frames)
        if self._clock.strandings != strandings:
            self.lateness.forget()
        return reading

    def add_lateness(self, late_s: float, seconds: float, clock: ClockReading) -> None:
        """Count a callback's lateness if its clock is settled. seconds: length of its block."""
        if not clock.settled:
            self.lateness.paused_s = 0.0  # the stream has restarted
        elif math.isfinite(late_s):
            self.lateness.add(late_s, seconds, clock.astray)


class Written(NamedTuple):
    """Values that the writing thread passes to the reading thread.

    frames: number of frames written so far, the counter of `clock`. run_start: index of the first
    frame after the last gap in the capture; earlier frames are not played after the gap.
    """

    frames: int
    clock: ClockReading
    run_start: int
    lateness_s: float
    lateness_known: bool


class WriteTiming:
    """The clock and the lateness of the captured stream, from the capture times of its frames.

    The writing thread calls `add`; any thread may call `expect_jump`. written: None until known.
    """

    def __init__(self, samplerate: float, block_frames: int) -> None:
        self._samplerate = samplerate
        self._block_s = block_frames / samplerate
        self._timing = StreamTiming(samplerate, block_frames)
        self._last_s = -math.inf
        self._jump_wanted = self._jump_expected = object()
        self.written: Written | None = None

    def expect_jump(self) -> None:
        """Announce that the source will change, with a gap before the next frames."""
        self._jump_wanted = object()

    def add(self, frames: int, end: int, now_s: float, earlier: Sequence[Part]) -> None:
        """Process the capture times of the last `frames` of `end` frames; see `DelayLine.write`."""
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
                # lag of the captured frames behind the clock just before this part arrived
                late_s = part_s - clock.time_of(part) - self._block_s
                self._timing.add_lateness(late_s, (part_end - part) / self._samplerate, clock)
            part = part_end
        if clock is None:  # no time has been finite yet
            return
        before, lateness = self.written, self._timing.lateness
        run_start = start if stalled or before is None else before.run_start
        self.written = Written(end, clock, run_start, lateness.estimate_s, lateness.known)


class Lateness:
    """The 99.9th percentile of the callbacks' lateness, in steps of 0.1 ms.

    The weight of a callback halves every 60 s. With few callbacks, the estimate is the greatest
    lateness. If one pause of the machine delays several callbacks, they count as one, with the
    greatest lateness. A pause that turns out to be a jump of the frame counter does not count.
    limit_s: largest estimate; callbacks that are later may cause an underflow. estimate_s: 0.5 ms
    to `limit_s`; a decrease of up to 1 ms is ignored. known: whether the estimate has been
    computed. paused_s: greatest lateness of the present pause, 0 for none. Any thread may read the
    attributes; one thread calls the methods.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._counts = [0.0] * (max(1, round(limit_s / _BIN_S)) + 1)
        self._unseen_s = self.paused_s = 0.0
        self._weight, self.estimate_s = 1.0, min(LEAST_S, limit_s)
        self.known = False

    def add(self, late_s: float, seconds: float, paused: bool) -> None:
        """Count one callback. paused: whether a pause has delayed the callback."""
        if paused:
            self.paused_s = max(self.paused_s, late_s)
            return
        if self.paused_s:
            self._count(self.paused_s)
            self.paused_s = 0.0
        self._count(late_s)
        # The weight of new entries increases, so that old entries need no update.
        self._weight *= 2.0 ** min(1.0, seconds / _HALF_LIFE_S)
        if self._weight > _HEAVIEST:
            self._counts = [count / self._weight for count in self._counts]
            self._weight = 1.0
        self._unseen_s += seconds
        if self._unseen_s >= _EVERY_S:
            self._unseen_s = 0.0
            self.known = True
            from_latest = list(accumulate(reversed(self._counts)))
            beyond = bisect.bisect_right(from_latest, SHARE * from_latest[-1])
            late_s = min(self._limit_s, max(LEAST_S, (len(self._counts) - beyond) * _BIN_S))
            if late_s > self.estimate_s + _RISE_S or late_s < self.estimate_s - _FALL_S:
                self.estimate_s = late_s

    def forget(self) -> None:
        """Discard all entries, which were measured against a wrong clock."""
        self._counts = [0.0] * len(self._counts)
        self._weight = 1.0
        self.paused_s = 0.0
        self.estimate_s = min(LEAST_S, self._limit_s)

    def _count(self, late_s: float) -> None:
        self._counts[min(len(self._counts) - 1, max(0, int(late_s / _BIN_S)))] += self._weight

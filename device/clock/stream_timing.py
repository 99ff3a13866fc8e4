"""When one stream's frames are due, and how late its callbacks come: what each side keeps."""

from __future__ import annotations

import math

from device.clock.lateness import Lateness
from device.clock.timing import ClockReading, FrameClock


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

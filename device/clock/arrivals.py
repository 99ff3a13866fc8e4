"""The writing side of a delay line: frames, and the times of their capture."""

from __future__ import annotations

import math
from collections.abc import Sequence

from device.clock.frame_clock import STALLED_S, ClockReading
from device.clock.ring import NewestFrames
from device.clock.shared_state import Written
from device.clock.stream_timing import StreamTiming
from device.units import Float32Array, FloatArray


class Arrivals:
    """Stores captured frames in a ring and tracks the clock of their stream.

    ring: to write to. samplerate: nominal, Hz. block_frames: of a usual block. lateness_limit_s:
    see `Lateness`. `store` is called by the writing thread; any thread may call the rest.

    written: what the reader may know; None until a frame's capture time is known.
    """

    def __init__(
        self, ring: NewestFrames, samplerate: float, block_frames: int, lateness_limit_s: float
    ) -> None:
        self._ring = ring
        self._samplerate = samplerate
        self._block_s = block_frames / samplerate
        self._timing = StreamTiming(samplerate, block_frames, lateness_limit_s)
        self._last_s = -math.inf
        self._jump_wanted: object = None
        self._jump_expected: object = None
        self.written: Written | None = None

    def expect_jump(self) -> None:
        """Announce that the source is about to change, with a gap before the next frames."""
        self._jump_wanted = object()

    def store(
        self,
        frames: FloatArray | Float32Array,
        now_s: float,
        earlier: Sequence[tuple[float, int]],
    ) -> None:
        """Store (frames, channels), at least 1, captured until now_s; see `DelayLine.write`."""
        first_s = earlier[0][0] if earlier else now_s
        stalled = not first_s - self._last_s < STALLED_S
        end = self._ring.store(frames)
        if math.isfinite(now_s):
            self._last_s = now_s
        if self._jump_wanted is not self._jump_expected:
            self._jump_expected = self._jump_wanted
            self._timing.expect_jump()
        start = part = end - len(frames)
        for part_s, frames_by_then in earlier:
            self._time(part_s, part, start + frames_by_then)
            part = start + frames_by_then
        clock = self._time(now_s, part, end)
        if clock is None:  # no time has been finite so far
            return
        before, timing = self.written, self._timing
        run_start = start if stalled or before is None else before.run_start
        self.written = Written(end, clock, run_start, timing.lateness_s, timing.known)

    def _time(self, now_s: float, start: int, end: int) -> ClockReading | None:
        """Update the clock with the capture time of the frames from `start` to `end`."""
        clock = self._timing.update(now_s, end)
        if clock is not None:
            # how far the captured frames lagged behind the clock just before these arrived
            late_s = now_s - clock.time_of(start) - self._block_s
            seconds = (end - start) / self._samplerate
            self._timing.add_lateness(late_s, seconds, clock)
        return clock

"""The delay line between the tap's clock and the output's clock."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

from device.clock.delay_control import RateLoop, TargetDelay
from device.clock.frame_clock import ClockReading
from device.clock.ring import CubicReader, Joint, NewestFrames
from device.clock.stream_timing import LEAST_S, StreamTiming, WriteTiming, Written
from device.errors import UsageError
from device.units import Float32Array, FloatArray, check_channels

LATENESS_LIMIT_S = 0.03  # per side; later callbacks are underflows
RESYNC_FRAMES = 256
FAR_OFF_S = 0.1  # an error of the delay that is corrected even before both clocks are settled
LOCK_S = 0.00025
UNLOCK_S = 0.001
LOCK_AFTER_S = 1.0
STARVED_AGAIN_S = 1.0
HOLD_OFF_S = 0.25  # silence after the second starvation within a second: regular bursts would buzz


class DelayState(enum.Enum):
    """The state of a delay line. Every recovery passes FILLING or STARVED."""

    EMPTY = "empty"  # nothing written since the start or the last flush; reads give silence
    FILLING = "filling"  # too few frames for the target, or a clock is still unknown
    SETTLING = "settling"  # playing; the delay is being steered to the target
    LOCKED = "locked"  # playing; the delay has been on the target for a second
    STARVED = "starved"  # the frames ran out; silence until the target is filled again


_PLAYING = (DelayState.SETTLING, DelayState.LOCKED)


class DelayStatus(NamedTuple):
    """A consistent report of a delay line, from the last read.

    delay_s: time from the capture of a frame to its place in the output, without the cards'
    latencies; 0 unless SETTLING or LOCKED. ratio_ppm: how much faster than nominal frames are read,
    within ±2000, and 1000 more while the target moves. resyncs: jumps because the delay was too far
    off, without those to a new offset. overflows: how often frames were lost before their read.
    """

    target_s: float
    delay_s: float
    ratio_ppm: float
    resyncs: int
    underflows: int
    overflows: int
    state: DelayState


class DelayLine:
    """Gives the written frames at the output's rate, after a constant delay.

    The target is 1.5 capture blocks + one output block + lateness + offset (see `TargetDelay` and
    `Lateness`). A delay further off than max(256 frames, half a capture block) is corrected by a
    jump; otherwise the read ratio is steered (see `RateLoop`). The delay counts from a frame's
    capture to its place in the output's block, by `FrameClock`, so block sizes do not show in it.

    One thread at a time calls `write` and one calls `read`; any thread may call the rest, and
    none waits. Frames cross as in `NewestFrames`, all else as an immutable object in one attribute.
    Times are taken when the callback began.

    channels: of every block. samplerate_in, samplerate_out: nominal, Hz; they may differ.
    capacity_s: of the memory, allocated at once; the target stays within three quarters of it.
    capture_block, output_block: frames of a usual `write` and `read`; others count as lateness.
    offset_s: delay added to the necessary one, 0 or more. lateness_least_s: the least lateness to
    plan for, so that the first late callbacks do not move the delay. status: after the last read.

    UsageError: offset_s or capacity_s is out of range. InternalError: a block has a wrong shape.
    Nothing else passed to `write` or `read` raises, and `read` still gives finite frames.
    """

    def __init__(
        self,
        channels: int,
        samplerate_in: float,
        samplerate_out: float,
        *,
        capacity_s: float = 2.0,
        capture_block: int = 256,
        output_block: int = 256,
        offset_s: float = 0.0,
        lateness_least_s: float = 0.0,
    ) -> None:
        least_s = 1.5 * capture_block / samplerate_in + output_block / samplerate_out
        needed_s = (least_s + 2.0 * LATENESS_LIMIT_S) / 0.75
        if not needed_s <= capacity_s < math.inf:
            raise UsageError(
                f"capacity_s={capacity_s} is too short for these blocks; "
                f"choose {needed_s:.3f} or more"
            )
        self.channels = channels
        self.samplerate_in, self.samplerate_out = float(samplerate_in), float(samplerate_out)
        self._lateness_least_s = lateness_least_s
        self._most_offset_s = 0.75 * (capacity_s - needed_s)
        self._resync_frames = max(RESYNC_FRAMES, capture_block // 2)

        self._ring = NewestFrames(math.ceil(capacity_s * samplerate_in), channels)
        self._writes = WriteTiming(samplerate_in, capture_block, LATENESS_LIMIT_S)
        # the reader's state
        self._reads = StreamTiming(samplerate_out, output_block, LATENESS_LIMIT_S)
        self._output_block = output_block
        self._output_s = output_block / samplerate_out
        self._read_frames = 0
        self._reader = CubicReader(self._ring.frames)
        self._joint = Joint(samplerate_out, channels)
        self._loop = RateLoop(samplerate_in)
        jump_s = self._resync_frames / self.samplerate_in
        self._target = TargetDelay(least_s, 0.75 * capacity_s, jump_s)
        self._state = DelayState.EMPTY
        self._step = self._nominal_step = self.samplerate_in / self.samplerate_out
        self._delay_s = self._on_target_s = self._stepped_s = 0.0
        self._known = self._flushing = False
        self._starved_at_s = self._not_before_s = -math.inf
        self._resyncs = self._underflows = self._overflows = 0
        self._from_frame = -1  # frames up to here were flushed
        # set by any thread
        self._flush_wanted = -1
        self._offset_s = 0.0
        self.offset_s = self._offset_in_force_s = offset_s
        self._target.set_goal(2.0 * LEAST_S, offset_s)
        self._target.jump()
        self.status = self._status()

    @property
    def offset_s(self) -> float:
        """Delay added to the necessary delay, s. A change takes effect in the next read."""
        return self._offset_s

    @offset_s.setter
    def offset_s(self, offset_s: float) -> None:
        if not 0.0 <= offset_s <= self._most_offset_s:
            raise UsageError(
                f"offset_s={offset_s} is out of range; "
                f"choose 0 to {self._most_offset_s:.3f}, or a larger capacity_s"
            )
        self._offset_s = float(offset_s)

    def flush(self) -> None:
        """Drop all frames so far: the next read fades to silence. Any thread may call it."""
        self._flush_wanted = self._ring.claimed

    def expect_jump(self) -> None:
        """Let the clock start again at the next late callback. Any thread may call it."""
        self._writes.expect_jump()

    def write(
        self,
        frames: FloatArray | Float32Array,
        now_s: float,
        earlier: Sequence[tuple[float, int]] = (),
    ) -> None:
        """Store a copy of (frames, channels), any number of frames, captured until now_s.

        earlier: if they were captured in parts, (time, frames until then) of each except the last.
        """
        check_channels(frames, self.channels)
        if len(frames):
            end = self._ring.store(frames)
            self._writes.add(len(frames), end, float(now_s), earlier)

    @property
    def readable(self) -> int:
        """Frames that a `read` gives now; 0 while not playing. For the reading thread."""
        written = self._writes.written
        if written is None or self._state not in _PLAYING:
            return 0
        return self._reader.readable(written.frames, self._step)

    def read(self, out: Float32Array, now_s: float, ahead: int = 0) -> int:
        """Fill (frames, channels), any number, to be played from now_s on; silence if missing.

        ahead: how many of the last frames are optional. Returns how many frames were filled.
        """
        check_channels(out, self.channels)
        frames = len(out)
        if not frames:
            return 0
        now_s = float(now_s)
        written = self._writes.written
        clock = self._reads.update(now_s, self._read_frames)
        if self._flush_wanted != self._from_frame:
            self._from_frame = self._flush_wanted
            self._stop(DelayState.EMPTY)
            self._flushing = True
        played, filled = 0, frames - ahead
        if written is not None and clock is not None:
            self._steer(written, clock, now_s, frames, ahead)
            if self._state in _PLAYING:
                there = self._reader.readable(written.frames, self._step)
                filled = max(filled, min(frames, there))
                played = self._play(out[: min(filled, there)], filled, now_s)
        out = out[:filled]
        self._read_frames += filled
        out[played:] = 0.0
        self._joint.apply(out[played:])
        self.status = self._status()
        return filled

    def _steer(
        self, written: Written, clock: ClockReading, now_s: float, frames: int, ahead: int
    ) -> None:
        seconds = frames / self.samplerate_out
        early_s = clock.time_of(clock.frames + frames - ahead) - now_s - self._output_s
        self._reads.add_lateness(early_s, seconds, clock)
        known = clock.settled and written.clock.settled
        # A corrected clock changes the measured delay, but not the delay: do not steer.
        stepped_s = clock.stepped_s - written.clock.stepped_s
        if known and self._known:
            self._target.current_s += stepped_s - self._stepped_s
        self._known, self._stepped_s = known, stepped_s
        late_s = written.lateness_s + self._reads.lateness.estimate_s
        before_s, self._offset_in_force_s = self._offset_in_force_s, self._offset_s
        by_user = before_s != self._offset_in_force_s
        self._target.set_goal(max(self._lateness_least_s, late_s), self._offset_in_force_s)
        slew = self._target.move(seconds)
        captured = written.clock.frames_at(clock.time_s)
        if self._state in _PLAYING:
            self._measure(captured, seconds, slew, known, by_user)
        if self._state not in _PLAYING and written.frames > self._from_frame:
            if self._state is DelayState.EMPTY:
                self._state = DelayState.FILLING
            held_off = self._starved_at_s <= now_s < self._not_before_s
            # A start too close to the newest frame would starve at the first late callback.
            provided = written.lateness_known and self._reads.lateness.known
            # Start at once after a flush: the clocks may correct the delay later by a jump.
            flushed = self._state is DelayState.FILLING and self._flushing
            if provided and (known or flushed) and not held_off:
                self._start(written, captured, frames)

    def _measure(
        self, captured: float, seconds: float, slew: float, known: bool, by_user: bool
    ) -> None:
        """Steer, or stop for a jump; by_user: the user has just changed the delay."""
        held = captured - self._reader.position - self._reader.fraction
        self._delay_s = held / self.samplerate_in
        error = held - self._target.current_s * self.samplerate_in
        off_s = abs(error / self.samplerate_in)
        if self._reader.position - 1 < self._ring.oldest:
            self._overflows += 1
            self._stop(DelayState.FILLING)
        elif abs(error) > (self._resync_frames if known else FAR_OFF_S * self.samplerate_in):
            self._resyncs += not by_user
            self._stop(DelayState.FILLING)
        elif known:
            ratio = self._loop.update(error, seconds)
            self._step = self._nominal_step * (ratio - slew)
            self._on_target_s = self._on_target_s + seconds if off_s < LOCK_S else 0.0
            if self._on_target_s >= LOCK_AFTER_S:
                self._state = DelayState.LOCKED
            elif off_s > UNLOCK_S:
                self._state = DelayState.SETTLING

    def _start(self, written: Written, captured: float, frames: int) -> None:
        """Play from the target delay, once a usual block is readable from there."""
        self._target.jump()
        position = math.floor(captured - self._target.current_s * self.samplerate_in)
        earliest = max(self._from_frame, written.run_start, self._ring.oldest) + 1
        self._reader.jump_to(position)
        usual = min(frames, self._output_block)
        if position >= earliest and self._reader.readable(written.frames, self._step) >= usual:
            self._loop.restart()
            self._step = self._nominal_step * self._loop.ratio
            self._delay_s = (captured - position) / self.samplerate_in
            self._on_target_s = 0.0
            self._joint.begin()
            self._flushing = False
            self._state = DelayState.SETTLING

    def _play(self, out: Float32Array, wanted: int, now_s: float) -> int:
        """Fill `out` with the readable part of the frames wanted; return how many were played."""
        first = self._reader.position - 1
        self._reader.read(out, self._step)
        if first < self._ring.oldest:  # the writer overwrote frames in the meantime
            self._overflows += 1
            self._stop(DelayState.FILLING)
            return 0
        self._joint.apply(out)
        if len(out) < wanted:
            self._underflows += 1
            if now_s - self._starved_at_s < STARVED_AGAIN_S:
                self._not_before_s = now_s + HOLD_OFF_S
            self._starved_at_s = now_s
            self._stop(DelayState.STARVED)
        return len(out)

    def _stop(self, state: DelayState) -> None:
        if self._state in _PLAYING:
            self._joint.begin()
        self._state = state
        self._delay_s = 0.0

    def _status(self) -> DelayStatus:
        return DelayStatus(
            self._target.current_s,
            self._delay_s,
            1e6 * (self._step / self._nominal_step - 1.0),
            self._resyncs,
            self._underflows,
            self._overflows,
            self._state,
        )

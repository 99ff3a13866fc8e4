"""The delay line between the clock of the capture and the clock of the output."""

import math
from collections.abc import Sequence

import numpy as np

from device import blocks
from device.clock.delay_control import PLAYING, DelayState, DelayStatus, RateLoop, TargetDelay
from device.clock.frame_clock import ClockReading
from device.clock.stream_timing import LEAST_S, Part, StreamTiming, WriteTiming, Written
from device.units import Block, Float32Array, check_channels

LARGEST = 1e6  # larger magnitudes count as invalid: arithmetic with them could overflow
FADE_S = 0.005
SLOPE_S = 0.0005  # time constant with which an extrapolated slope decays
STEEPEST_HZ = 250.0  # an extrapolated slope is at most that of a full-scale sine of this frequency
RESYNC_FRAMES = 256
FAR_OFF_S = 0.1  # a larger error causes a jump even before both clocks are settled
STARVED_AGAIN_S = 1.0
HOLD_OFF_S = 0.25  # silence after two starvations within a second: frequent restarts would buzz


class NewestFrames:
    """A ring buffer of the newest frames; new frames overwrite the oldest frames.

    One thread writes and another reads, without locks. The writer first sets `claimed`, the count
    of all frames including the frames being stored. The writer then stores the frames, and
    publishes the new count as `Written.frames`. The reader uses the frames from index `oldest` to
    below this count. Then the reader loads `oldest` again. If `oldest` is now above the index of
    the first used frame, the writer may have overwritten some of the used frames. Attributes must
    be loaded and stored atomically and in order, as in CPython.

    frames: float32 (capacity, channels); frame k is in row k % capacity.
    """

    def __init__(self, capacity: int, channels: int) -> None:
        self.frames = np.zeros((capacity, channels), np.float32)
        self.claimed = 0

    @property
    def oldest(self) -> int:
        """Index, in the whole stream, of the oldest frame that is not being overwritten."""
        return self.claimed - len(self.frames)

    def store(self, block: Block) -> int:
        """Store a block, (frames, channels), of any length; return the count of all frames so far.

        NaN, and magnitudes above `LARGEST`, become 0. Only the writing thread calls it.
        """
        capacity = len(self.frames)
        self.claimed = end = self.claimed + len(block)
        block = block[-capacity:]
        first = (end - len(block)) % capacity
        with np.errstate(over="ignore", invalid="ignore"):
            for part, start in ((block[: capacity - first], first), (block[capacity - first :], 0)):
                rows = self.frames[start : start + len(part)]
                rows[:] = part
                if not blocks.peak(part) <= LARGEST:
                    rows[~(np.abs(rows) <= LARGEST)] = 0.0  # NaN becomes 0, too
        return end


class CubicReader:
    """Reads a ring of frames at any ratio, by cubic Lagrange interpolation of four frames.

    For a sine of 500 Hz at 48 kHz, the r.m.s. error is -130 dB relative to the sine. The next read
    starts at frame `position` + `fraction` of the stream. A single float64 would keep only about
    20 bits of the fraction after a day. ring: `NewestFrames.frames`. Only the reading thread
    calls the methods. NotFoundError: the compiled library is missing.
    """

    def __init__(self, ring: Float32Array) -> None:
        self._ring = ring
        self._cubic = blocks.require_compiled().cubic
        self.jump_to(0)

    def jump_to(self, position: int) -> None:
        """Set the position to a whole number of frames."""
        self.position, self.fraction = position, 0.0

    def readable(self, written: int, step: float) -> int:
        """Return how many frames can be read. written: count of all frames stored so far."""
        reach = written - self.position - 2 - self.fraction  # the cubic needs two later frames
        return max(0, math.ceil(reach / step))

    def read(self, out: Float32Array, step: float) -> None:
        """Fill `out`, (frames, channels). Each frame of `out` advances the position by `step`."""
        frames = np.require(out, np.float32, ["C", "A", "W"])  # `out` itself, unless strided
        self._cubic(self._ring, frames, (self.position - 1) % len(self._ring), self.fraction, step)
        if frames is not out:
            out[:] = frames
        end = self.fraction + len(out) * step
        self.position += math.floor(end)
        self.fraction = end - math.floor(end)


class Joint:
    """Cross-fades from the previous signal to the next signal over 5 ms, without a click.

    The previous signal may have ended, so its last value and slope are extrapolated. The
    extrapolation is faded out while the next signal is faded in, both with a raised cosine. Only
    the reading thread calls the methods.
    """

    def __init__(self, samplerate: float, channels: int) -> None:
        frames = max(2, round(FADE_S * samplerate))
        since = np.arange(1, frames + 1)[:, np.newaxis]
        self._rising = 0.5 - 0.5 * np.cos(np.pi * since / frames)
        self._falling = 1.0 - self._rising
        self._ramp = since * np.exp(-(since - 1) / (SLOPE_S * samplerate)) * self._falling
        self._steepest = 2.0 * math.pi * STEEPEST_HZ / samplerate
        self._tail = np.zeros((frames, channels))
        self._scratch = np.zeros_like(self._tail)
        self._last_two = np.zeros((2, channels), np.float32)
        self._done = frames

    def begin(self) -> None:
        """Start a fade at the next frame."""
        before, last = self._last_two.astype(np.float64)
        slope = np.clip(last - before, -self._steepest, self._steepest)
        np.multiply(self._falling, last, out=self._tail)
        self._tail += self._ramp * slope
        self._done = 0

    def apply(self, out: Float32Array) -> None:
        """Fade a block, (frames, channels), in place, and remember its last two frames."""
        if not len(out):
            return
        if under_way := min(len(out), len(self._tail) - self._done):
            now = slice(self._done, self._done + under_way)
            mixed = np.multiply(out[:under_way], self._rising[now], out=self._scratch[:under_way])
            out[:under_way] = np.add(mixed, self._tail[now], out=mixed)
            self._done += under_way
        self._last_two[0] = self._last_two[1]
        self._last_two[-len(out) :] = out[-2:]


class DelayLine:
    """Returns the written frames at the output's rate, after a constant delay.

    The delay is the time from a frame's capture to its output, measured with a `FrameClock` for
    each side. `TargetDelay` gives the target of the delay. If the delay differs from the target by
    more than max(256 frames, half a capture block), the delay jumps to the target. While a clock is
    not settled, only differences of more than 0.1 s cause a jump. With settled clocks, `RateLoop`
    corrects smaller differences by changes of the read ratio.

    One thread at a time calls `write` and one calls `read`. Any thread may call the other methods.
    No method waits. Time arguments are the start times of callbacks.
    channels: number of channels. samplerate_in, samplerate_out: nominal, Hz; they may differ.
    capacity_s: length of the ring buffer; the target is at most 75 % of it.
    capture_block, output_block: usual length of a `write` and a `read`, in frames; longer blocks
    count as late. offset_s: additional delay, 0 or more. lateness_least_s: least assumed lateness,
    so that the first late callbacks do not change the delay. expect_jump: function to call before a
    gap in the capture. status: state, delay and counts at the last read.
    UsageError: offset_s or capacity_s is out of range. InternalError: a block has a wrong shape.
    Other invalid arguments of `write` and `read` raise no error. All frames from `read` are finite.
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
        self.channels = channels
        self.samplerate_in, self.samplerate_out = float(samplerate_in), float(samplerate_out)
        self._lateness_least_s = lateness_least_s
        self._resync_frames = max(RESYNC_FRAMES, capture_block // 2)
        least_s = 1.5 * capture_block / samplerate_in + output_block / samplerate_out
        self._target = TargetDelay(least_s, capacity_s, self._resync_frames / samplerate_in)
        self._ring = NewestFrames(math.ceil(capacity_s * samplerate_in), channels)
        self._writes = WriteTiming(samplerate_in, capture_block)
        self.expect_jump = self._writes.expect_jump
        self._reads = StreamTiming(samplerate_out, output_block)
        self._output_block = output_block
        self._reader = CubicReader(self._ring.frames)
        self._joint = Joint(samplerate_out, channels)
        self._loop = RateLoop(samplerate_in)
        self._state = DelayState.EMPTY
        self._step = self._nominal_step = self.samplerate_in / self.samplerate_out
        self._delay_s = 0.0
        self._flushing = False
        self._starved_at_s = self._not_before_s = -math.inf
        self._read_frames = self._resyncs = self._underflows = self._overflows = 0
        self._from_frame = self._flush_wanted = -1  # first frame after the last and the next flush
        self.offset_s = offset_s
        self._target.set_goal(2.0 * LEAST_S, offset_s)
        self._target.jump()
        self.status = DelayStatus(self._target.current_s, offset_s=offset_s)

    @property
    def offset_s(self) -> float:
        """Additional delay in s. A change takes effect in the next read."""
        return self._offset_s

    @offset_s.setter
    def offset_s(self, offset_s: float) -> None:
        self._target.check_offset(offset_s)
        self._offset_s = float(offset_s)

    def flush(self) -> None:
        """Drop all written frames: the next read fades to silence. Any thread may call it."""
        self._flush_wanted = self._ring.claimed

    def write(self, frames: Block, now_s: float, earlier: Sequence[Part] = ()) -> None:
        """Copy a block, (frames, channels), that was captured until now_s.

        earlier: all parts of the block except the last part, see `Part`.
        """
        check_channels(frames, self.channels)
        if len(frames):
            self._writes.add(len(frames), self._ring.store(frames), float(now_s), earlier)

    @property
    def readable(self) -> int:
        """Number of frames that `read` can return, 0 unless playing. For the reading thread."""
        written = self._writes.written
        playing = self._state in PLAYING
        return self._reader.readable(written.frames, self._step) if written and playing else 0

    def read(self, out: Float32Array, now_s: float, ahead: int = 0) -> int:
        """Fill `out`, (frames, channels); return how many frames are filled. Missing frames are 0.

        ahead: number of frames at the end of `out` that need not be filled.
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
            if self._state in PLAYING:
                there = self._reader.readable(written.frames, self._step)
                filled = max(filled, min(frames, there))
                played = self._play(out[: min(filled, there)], filled, now_s)
        out = out[:filled]
        self._read_frames += filled
        out[played:] = 0.0
        self._joint.apply(out[played:])
        ppm = 1e6 * (self._step / self._nominal_step - 1.0)
        counts = self._resyncs, self._underflows, self._overflows
        known = ppm, *counts, self._state, self._target.offset_s
        self.status = DelayStatus(self._target.current_s, self._delay_s, *known)
        return filled

    def _steer(
        self, written: Written, clock: ClockReading, now_s: float, frames: int, ahead: int
    ) -> None:
        seconds = frames / self.samplerate_out
        early_s = clock.time_of(clock.frames + frames - ahead) - now_s
        early_s -= self._output_block / self.samplerate_out
        self._reads.add_lateness(early_s, seconds, clock)
        known = clock.settled and written.clock.settled
        self._target.follow_clocks(clock.stepped_s - written.clock.stepped_s, known)
        late_s = written.lateness_s + self._reads.lateness.estimate_s
        by_user = self._target.set_goal(max(self._lateness_least_s, late_s), self._offset_s)
        slew = self._target.move(seconds)
        captured = written.clock.frames_at(clock.time_s)
        if self._state in PLAYING:
            self._measure(captured, seconds, slew, known, by_user)
        if self._state not in PLAYING and written.frames > self._from_frame:
            if self._state is DelayState.EMPTY:
                self._state = DelayState.FILLING
            held_off = self._starved_at_s <= now_s < self._not_before_s
            # A start too close to the newest frame would starve at the first late callback.
            provided = written.lateness_known and self._reads.lateness.known
            # After a flush the start is immediate; a jump may correct the delay later.
            flushed = self._state is DelayState.FILLING and self._flushing
            if provided and (known or flushed) and not held_off:
                self._start(written, captured, frames)

    def _measure(
        self, captured: float, seconds: float, slew: float, known: bool, by_user: bool
    ) -> None:
        """Control the read ratio. After a large error or an overflow, stop; a jump follows."""
        held = captured - self._reader.position - self._reader.fraction
        self._delay_s = held / self.samplerate_in
        error = held - self._target.current_s * self.samplerate_in
        if self._reader.position - 1 < self._ring.oldest:
            self._overflows += 1
            self._stop(DelayState.FILLING)
        elif abs(error) > (self._resync_frames if known else FAR_OFF_S * self.samplerate_in):
            self._resyncs += not by_user
            self._stop(DelayState.FILLING)
        elif known:
            self._step = self._nominal_step * (self._loop.update(error, seconds) - slew)
            self._state = DelayState.LOCKED if self._loop.locked else DelayState.SETTLING

    def _start(self, written: Written, captured: float, frames: int) -> None:
        """Start to play at the target delay if a block of usual length can be read."""
        self._target.jump()
        position = math.floor(captured - self._target.current_s * self.samplerate_in)
        earliest = max(self._from_frame, written.run_start, self._ring.oldest) + 1
        self._reader.jump_to(position)
        usual = min(frames, self._output_block)
        if position >= earliest and self._reader.readable(written.frames, self._step) >= usual:
            self._loop.restart()
            self._step = self._nominal_step * self._loop.ratio
            self._delay_s = (captured - position) / self.samplerate_in
            self._joint.begin()
            self._flushing = False
            self._state = DelayState.SETTLING

    def _play(self, out: Float32Array, wanted: int, now_s: float) -> int:
        """Fill `out` from the ring; return the number of filled frames, 0 after an overflow."""
        first = self._reader.position - 1
        self._reader.read(out, self._step)
        if first < self._ring.oldest:  # the writer overwrote frames during the read
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
        if self._state in PLAYING:
            self._joint.begin()
        self._state = state
        self._delay_s = 0.0

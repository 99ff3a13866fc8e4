"""The states of a delay line, its target delay, and the control loop of its read rate."""

import enum
import math
from typing import NamedTuple

from device.clock.stream_timing import LATENESS_LIMIT_S
from device.errors import UsageError

LOCK_S, UNLOCK_S, LOCK_AFTER_S = 0.00025, 0.001, 1.0
WIDE_HZ, NARROW_HZ, WIDE_FOR_S = 0.128, 0.02, 10.0  # bandwidths, and duration of the wide one
MAX_DEVIATION = 2_000e-6
_DAMPING, _SMOOTHING = 1.6, 20.0

SLEW = 1_000e-6  # largest speed of the target, in s/s: an imperceptible change of pitch
NEAR_S = 1.0  # time constant of the approach to the target


class DelayState(enum.Enum):
    """The state of a delay line. Playing always starts from FILLING or STARVED."""

    EMPTY = "empty"  # nothing written since the start or the last flush; reads return silence
    FILLING = "filling"  # too few frames for the target, or a clock is still unknown
    SETTLING = "settling"  # playing; the delay approaches the target
    LOCKED = "locked"  # playing; the delay has reached the target, and stays within 1 ms of it
    STARVED = "starved"  # the frames ran out; silence until enough frames for the target exist


PLAYING = (DelayState.SETTLING, DelayState.LOCKED)


class DelayStatus(NamedTuple):
    """State, delay and counts of a delay line at its last read.

    delay_s: time from the capture of a frame to its output, without the latencies of the sound
    cards; 0 unless SETTLING or LOCKED. ratio_ppm: deviation of the read rate from nominal in ppm,
    within ±2000, or ±3000 while the target moves. resyncs: number of jumps of the delay after a
    large error; jumps to a new offset do not count. underflows: how often a read needed frames that
    were not yet written. overflows: how often frames were overwritten before they were read.
    offset_s: the user's offset, which target_s contains.
    """

    target_s: float
    delay_s: float = 0.0
    ratio_ppm: float = 0.0
    resyncs: int = 0
    underflows: int = 0
    overflows: int = 0
    state: DelayState = DelayState.EMPTY
    offset_s: float = 0.0


class RateLoop:
    """A third-order control loop: computes the read ratio from the error of the delay.

    If the clocks drift at a constant rate, the error decays to 0. The bandwidth is 0.128 Hz for
    10 s after a start or restart, then 0.02 Hz. Source: F. Adriaensen, zita-ajbridge, with the
    signs of error and ratio reversed. samplerate: of the captured frames, Hz. z3: learned relative
    difference of the clock rates. ratio: read rate divided by the nominal rate. locked: whether the
    error was below 0.25 ms for a second, and never above 1 ms since. The reading thread calls it.
    """

    def __init__(self, samplerate: float) -> None:
        self._samplerate = samplerate
        self.z3 = 0.0
        self.restart()

    def restart(self) -> None:
        """Restart after a jump of the delay, and keep the learned drift."""
        self.z1 = self.z2 = self._age_s = self._on_target_s = 0.0
        self.locked = False
        self.ratio = 1.0 + self.z3

    @property
    def wide(self) -> bool:
        """Whether the initial, wide bandwidth is in use."""
        return self._age_s < WIDE_FOR_S

    def update(self, error_frames: float, seconds: float) -> float:
        """Return the read ratio for the next `seconds`. error_frames: delay minus target."""
        if not math.isfinite(error_frames):
            return self.ratio
        off_s = abs(error_frames / self._samplerate)
        self._on_target_s = self._on_target_s + seconds if off_s < LOCK_S else 0.0
        self.locked = self._on_target_s >= LOCK_AFTER_S or (self.locked and off_s <= UNLOCK_S)
        omega = math.tau * (WIDE_HZ if self.wide else NARROW_HZ)
        self._age_s += seconds
        gain = -math.expm1(-_SMOOTHING * omega * seconds)
        self.z1 += gain * (_DAMPING * omega * error_frames / self._samplerate - self.z1)
        self.z2 += gain * (self.z1 - self.z2)
        # Integration beyond the limit would cause an overshoot later.
        deviation = self.z2 + self.z3
        if abs(deviation) < MAX_DEVIATION or deviation * self.z2 < 0.0:
            self.z3 = _limited(self.z3 + min(1.0, omega * seconds / _DAMPING) * self.z2)
        self.ratio = 1.0 + _limited(self.z2 + self.z3)
        return self.ratio


def _limited(deviation: float) -> float:
    return max(-MAX_DEVIATION, min(MAX_DEVIATION, deviation))


class TargetDelay:
    """The target delay: the sum of least_s, the callbacks' lateness and the user's offset.

    A new offset acts at once, a new lateness slowly. least_s: length of 1.5 capture blocks and one
    output block. capacity_s: length of the ring buffer; the target is at most 75 % of it. jump_s:
    increases above this value act at once, because frames would run out during a slow increase.
    current_s: the present target. offset_s: the offset in it. UsageError: capacity_s is too short.
    """

    def __init__(self, least_s: float, capacity_s: float, jump_s: float) -> None:
        needed_s = (least_s + 2.0 * LATENESS_LIMIT_S) / 0.75
        if not needed_s <= capacity_s < math.inf:
            raise UsageError(
                f"capacity_s={capacity_s} is too short for these blocks; "
                f"choose {needed_s:.3f} or more"
            )
        self._least_s, self._most_s, self._jump_s = least_s, 0.75 * capacity_s, jump_s
        self._most_offset_s = 0.75 * (capacity_s - needed_s)
        self.offset_s = self._stepped_s = 0.0
        self._known = False
        self.wanted_s = self.current_s = least_s

    def check_offset(self, offset_s: float) -> None:
        """Raise UsageError if the offset is negative, or the ring buffer is too short for it."""
        if not 0.0 <= offset_s <= self._most_offset_s:
            raise UsageError(
                f"offset_s={offset_s} is out of range; "
                f"choose 0 to {self._most_offset_s:.3f}, or a larger capacity_s"
            )

    def follow_clocks(self, stepped_s: float, known: bool) -> None:
        """Move the target by the clocks' corrections, so that the real delay stays the same.

        stepped_s: sum of the output clock's corrections minus the sum of the capture clock's.
        known: whether both clocks are settled.
        """
        if known and self._known:
            self.current_s += stepped_s - self._stepped_s
        self._known, self._stepped_s = known, stepped_s

    def set_goal(self, lateness_s: float, offset_s: float) -> bool:
        """Set the final target; return whether the offset changed. A new offset acts at once."""
        if new_offset := offset_s != self.offset_s:
            self.current_s += offset_s - self.offset_s
            self.offset_s = offset_s
        self.wanted_s = self._clamp(self._least_s + lateness_s + offset_s)
        self.current_s = self._clamp(self.current_s)
        if self.wanted_s - self.current_s > self._jump_s:
            self.jump()
        return new_offset

    def jump(self) -> None:
        """Set the target to its final value at once."""
        self.current_s = self.wanted_s

    def move(self, seconds: float) -> float:
        """Move the target toward its final value during a block; return its speed in s/s."""
        share = min(1.0, seconds / NEAR_S)
        most_s = SLEW * seconds
        step_s = max(-most_s, min(most_s, share * (self.wanted_s - self.current_s)))
        self.current_s += step_s
        return step_s / seconds

    def _clamp(self, delay_s: float) -> float:
        return max(self._least_s, min(self._most_s, delay_s))

"""The delay that is aimed at, and the loop that steers the read ratio to it."""

from __future__ import annotations

import math

WIDE_HZ = 0.128
NARROW_HZ = 0.02
WIDE_FOR_S = 10.0
MAX_DEVIATION = 2_000e-6

_DAMPING = 1.6
_SMOOTHING = 20.0

SLEW = 1_000e-6  # greatest speed of the target, in s/s: an imperceptible change of pitch
NEAR_S = 1.0  # time constant of the approach, which slows small steps down


class RateLoop:
    """The third-order loop of zita-ajbridge, from a delay error to a read ratio.

    No error remains at a constant drift. The bandwidth is wide for 10 s after a restart, then
    narrow. F. Adriaensen, zita-ajbridge (there with the opposite signs of error and ratio).

    samplerate: Hz, of the frames that the error counts. z3: the drift between the clocks.
    ratio: frames to read for each nominal one. Called by the reading thread.
    """

    def __init__(self, samplerate: float) -> None:
        self._samplerate = samplerate
        self.z3 = 0.0
        self.restart()

    def restart(self) -> None:
        """Start again after a jump of the delay, and keep the drift learned so far."""
        self.z1 = self.z2 = 0.0
        self._age_s = 0.0
        self.ratio = 1.0 + self.z3

    @property
    def wide(self) -> bool:
        """Whether the initial, wide bandwidth is in use."""
        return self._age_s < WIDE_FOR_S

    def update(self, error_frames: float, seconds: float) -> float:
        """Return the ratio for the next block, `seconds` after the last update.

        The error is delay minus target; one that is not finite changes nothing.
        """
        if not math.isfinite(error_frames):
            return self.ratio
        omega = math.tau * (WIDE_HZ if self.wide else NARROW_HZ)
        self._age_s += seconds
        gain = -math.expm1(-_SMOOTHING * omega * seconds)
        self.z1 += gain * (_DAMPING * omega * error_frames / self._samplerate - self.z1)
        self.z2 += gain * (self.z1 - self.z2)
        # Integration against the limit would cause an overshoot later.
        deviation = self.z2 + self.z3
        if abs(deviation) < MAX_DEVIATION or deviation * self.z2 < 0.0:
            self.z3 = _limited(self.z3 + min(1.0, omega * seconds / _DAMPING) * self.z2)
        self.ratio = 1.0 + _limited(self.z2 + self.z3)
        return self.ratio


def _limited(deviation: float) -> float:
    return max(-MAX_DEVIATION, min(MAX_DEVIATION, deviation))


class TargetDelay:
    """The target delay: blocks, lateness and the user's offset, added up and changed slowly.

    least_s: 1.5 capture blocks and one output block; the half covers the worst phase between two
    unrelated clocks. most_s: what the buffer has room for. jump_s: a greater rise of the lateness
    takes effect at once, or frames would run out first. current_s: the present target.
    """

    def __init__(self, least_s: float, most_s: float, jump_s: float) -> None:
        self._least_s, self._most_s, self._jump_s = least_s, most_s, jump_s
        self._offset_s = 0.0
        self.wanted_s = self.current_s = least_s

    def set_goal(self, lateness_s: float, offset_s: float) -> None:
        """Set what to move to. A changed offset takes effect at once."""
        if offset_s != self._offset_s:
            self.current_s += offset_s - self._offset_s
            self._offset_s = offset_s
        self.wanted_s = self._clamp(self._least_s + lateness_s + offset_s)
        self.current_s = self._clamp(self.current_s)
        if self.wanted_s - self.current_s > self._jump_s:
            self.jump()

    def jump(self) -> None:
        """Reach the goal at once."""
        self.current_s = self.wanted_s

    def move(self, seconds: float) -> float:
        """Move for `seconds`; return the speed, in seconds per second."""
        share = min(1.0, seconds / NEAR_S)
        most_s = SLEW * seconds
        step_s = max(-most_s, min(most_s, share * (self.wanted_s - self.current_s)))
        self.current_s += step_s
        return step_s / seconds

    def _clamp(self, delay_s: float) -> float:
        return max(self._least_s, min(self._most_s, delay_s))

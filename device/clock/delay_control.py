"""How much faster than nominal to read, so that the delay stays where it should."""

from __future__ import annotations

import math

WIDE_HZ = 0.128
NARROW_HZ = 0.02
WIDE_FOR_S = 10.0
MAX_DEVIATION = 2_000e-6

_DAMPING = 1.6
_SMOOTHING = 20.0


class RateLoop:
    """The third-order loop of zita-ajbridge, from an error of the delay to a ratio of reading.

    samplerate: Hz, of the frames that the error is given in. Called by the reading thread.

    With B the seconds since the last update, e the error in frames and w = 2 pi bandwidth:

        z1 += (1 - exp(-20 w B)) (1.6 w e / samplerate - z1)
        z2 += (1 - exp(-20 w B)) (z1 - z2)
        z3 += w B / 1.6 z2
        ratio = 1 + z2 + z3

    which is damped by 0.8 and rests without error at any constant drift. The bandwidth is
    0.128 Hz for 10 s of updates after a restart, then 0.02 Hz; the ratio stays within ±2000 ppm.
    F. Adriaensen, zita-ajbridge (the same with the signs of error and ratio the other way round).

    z1, z2: the smoothed error, as a relative rate. z3: the drift between the clocks.
    ratio: frames to read for each nominal one, as of the last update.
    """

    def __init__(self, samplerate: float) -> None:
        self._samplerate = samplerate
        self.reset()

    def reset(self) -> None:
        """Forget everything, the drift included."""
        self.z3 = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin anew after a jump of the delay; the drift learned so far is kept."""
        self.z1 = self.z2 = 0.0
        self._age_s = 0.0
        self.ratio = 1.0 + self.z3

    @property
    def wide(self) -> bool:
        """Whether the first, wide bandwidth is in force."""
        return self._age_s < WIDE_FOR_S

    def update(self, error_frames: float, seconds: float) -> float:
        """The ratio for the next block, after `seconds`, from delay minus target in frames.

        An error that is not finite changes nothing.
        """
        if not math.isfinite(error_frames):
            return self.ratio
        omega = 2.0 * math.pi * (WIDE_HZ if self.wide else NARROW_HZ)
        self._age_s += seconds
        gain = -math.expm1(-_SMOOTHING * omega * seconds)
        self.z1 += gain * (_DAMPING * omega * error_frames / self._samplerate - self.z1)
        self.z2 += gain * (self.z1 - self.z2)
        # Integrating against the limit would be paid back by an overshoot.
        deviation = self.z2 + self.z3
        if abs(deviation) < MAX_DEVIATION or deviation * self.z2 < 0.0:
            self.z3 += min(1.0, omega * seconds / _DAMPING) * self.z2
            self.z3 = _limited(self.z3)
        self.ratio = 1.0 + _limited(self.z2 + self.z3)
        return self.ratio


def _limited(deviation: float) -> float:
    return max(-MAX_DEVIATION, min(MAX_DEVIATION, deviation))


SLEW = 1_000e-6
"""How fast the target may move, in seconds a second: a change of pitch that nobody feels."""
NEARS_S = 1.0
"""Time constant of the last part of the way: small steps are taken gently."""


class TargetDelay:
    """Blocks, lateness and the user's wish, added up; changes come slowly.

    least_s: 1.5 capture blocks and one output block; most_s: what the buffer has room for. One
    capture block passes before its first frame can be had and one output block is taken at
    once; the half block is what two unrelated clocks may meet badly. jump_s: a rise of the
    lateness by more is made at once, or frames would run out before it has an effect. Called by
    the reading thread.

    current_s: the target now, least_s to most_s.
    """

    def __init__(self, least_s: float, most_s: float, jump_s: float) -> None:
        self._jump_s = jump_s
        self._least_s = least_s
        self._most_s = most_s
        self._offset_s = 0.0
        self.wanted_s = self.current_s = least_s

    def want(self, lateness_s: float, offset_s: float) -> None:
        """Set what to move to. The user's own change of the offset is made at once."""
        if offset_s != self._offset_s:
            self.current_s += offset_s - self._offset_s
            self._offset_s = offset_s
        self.wanted_s = self._possible(self._least_s + lateness_s + offset_s)
        self.current_s = self._possible(self.current_s)
        if self.wanted_s - self.current_s > self._jump_s:
            self.jump()

    def jump(self) -> None:
        """Be where it should be, at once."""
        self.current_s = self.wanted_s

    def rebase(self, seconds: float) -> None:
        """Be told that the delay measures so much more from now on, without any change of it."""
        self.current_s += seconds

    def move(self, seconds: float) -> float:
        """Move for `seconds`; return how fast that was, in seconds a second."""
        share = min(1.0, seconds / NEARS_S)
        step_s = share * (self.wanted_s - self.current_s)
        step_s = max(-SLEW * seconds, min(SLEW * seconds, step_s))
        self.current_s += step_s
        return step_s / seconds

    def _possible(self, delay_s: float) -> float:
        return max(self._least_s, min(self._most_s, delay_s))

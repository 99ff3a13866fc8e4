"""The delay that a delay line steers to."""

from __future__ import annotations

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

"""What made the process, the machine or the sound stand still: noticed, counted, told."""

from __future__ import annotations

from collections.abc import Callable

from audioflinger_hook.service.state import Cause, StateKeeper

STALLED_S = 1.0
"""A tick later than this: the process stood still."""

SLEPT_S = 0.5
"""The machine has slept if it did so for longer."""


class StallDetector:
    """Notices pauses from one tick to the next. For the supervising thread alone.

    slept_s: see `Clocks`.
    """

    def __init__(self, states: StateKeeper, slept_s: Callable[[], float]) -> None:
        self._states = states
        self._slept = slept_s
        self._slept_s = slept_s()
        self._ticked_s: float | None = None
        self._resyncs = 0

    def woke(self, now_s: float, rest_s: float) -> bool:
        """Whether the machine has slept since the last tick; a stall of the process is counted.

        rest_s: how long the ticks are apart at most, if nothing stands still.
        """
        slept_s = self._slept()
        lay_s, self._slept_s = slept_s - self._slept_s, slept_s
        before_s, self._ticked_s = self._ticked_s, now_s
        if lay_s > SLEPT_S:
            self._states.recover(Cause.RESUMED, now_s, f"slept for {lay_s:.0f} s")
            return True
        late_s = 0.0 if before_s is None else now_s - before_s - rest_s
        if late_s > STALLED_S:
            self._states.count(Cause.STALL, f"everything stood still for {late_s:.1f} s")
        return False

    def count_resyncs(self, resyncs: int) -> None:
        """Count those of the delay line that are new; resyncs: so far."""
        for _ in range(resyncs - self._resyncs):
            self._states.count(Cause.RESYNC, "the computer was late: the delay was set anew")
        self._resyncs = resyncs

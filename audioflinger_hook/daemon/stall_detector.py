"""Notices that the process stalled, the machine was suspended, or the delay line restarted."""

from __future__ import annotations

from collections.abc import Callable

from audioflinger_hook.service.state import Cause, StateKeeper

STALLED_S = 1.0
"""Lateness of a tick that counts as a stall of the process."""

SLEPT_S = 0.5
"""Shortest suspend that counts."""


class StallDetector:
    """Counts stalls from one tick to the next. For the supervising thread alone."""

    def __init__(self, states: StateKeeper, slept_s: Callable[[], float]) -> None:
        self._states = states
        self._slept = slept_s
        self._slept_s = slept_s()
        self._ticked_s: float | None = None
        self._resyncs = 0

    def woke(self, now_s: float, rest_s: float) -> bool:
        """Return whether the machine was suspended since the last tick; count a stall.

        rest_s: longest time between ticks.
        """
        slept_s = self._slept()
        suspended_s, self._slept_s = slept_s - self._slept_s, slept_s
        before_s, self._ticked_s = self._ticked_s, now_s
        if suspended_s > SLEPT_S:
            self._states.recover(Cause.RESUMED, now_s, f"suspended for {suspended_s:.0f} s")
            return True
        late_s = 0.0 if before_s is None else now_s - before_s - rest_s
        if late_s > STALLED_S:
            self._states.count(Cause.STALL, f"the process stalled for {late_s:.1f} s")
        return False

    def count_resyncs(self, resyncs: int) -> None:
        """Count new restarts of the delay line; resyncs: total so far."""
        for _ in range(resyncs - self._resyncs):
            self._states.count(Cause.RESYNC, "processing fell behind; delay reset")
        self._resyncs = resyncs

"""Decisions that depend only on time: waits between attempts, rest, stalls and suspends."""

from __future__ import annotations

from collections.abc import Callable

from audioflinger_hook.service.state import Cause, StateKeeper

FIRST_S, LONGEST_S = 0.05, 0.5  # between attempts, which cost almost nothing


class Backoff:
    """Waits between attempts: FIRST_S, doubled after every failure, at most `longest_s`."""

    def __init__(self, longest_s: float = LONGEST_S) -> None:
        self._longest_s = longest_s
        self._next_wait_s = FIRST_S
        self._due_s: float | None = None

    def failed(self, now_s: float) -> float:
        """Count a failure; return the seconds to wait from `now_s` on."""
        wait_s = self._next_wait_s
        self._next_wait_s = min(self._longest_s, 2.0 * wait_s)
        self._due_s = now_s + wait_s
        return wait_s

    def succeeded(self) -> None:
        """Reset: the next attempt is due at once."""
        self._next_wait_s = FIRST_S
        self._due_s = None

    def wait_s(self, now_s: float) -> float:
        """Return the seconds until the next attempt; 0 if it is due."""
        if self._due_s is None:
            return 0.0
        # If the clock is set back, the wait must not become longer.
        return min(self._longest_s, max(0.0, self._due_s - now_s))


STALLED_S = 1.0  # lateness of a tick that counts as a stall of the process
SLEPT_S = 0.5  # shortest suspend that counts


class StallDetector:
    """Counts stalls from one tick to the next. For the supervising thread alone."""

    def __init__(self, states: StateKeeper, slept_s: Callable[[], float]) -> None:
        self._states = states
        self._slept = slept_s
        self._slept_s = slept_s()
        self._ticked_s: float | None = None
        self._resyncs = 0

    def woke(self, now_s: float, rest_s: float) -> bool:
        """Return whether the machine was suspended since the last tick; count a stall."""
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


QUIET_S = 5.0  # silence before resting if no application plays
# Although an application plays: its sound may begin without an event, and waking up then loses the
# first tenths of a second.
SILENT_S = 10.0
AWAKE_S = 8.0  # at least, as applications may open a stream some time before they play


class IdlePolicy:
    """Decides whether the streams rest, without side effects. resting: the current decision."""

    def __init__(self, now_s: float) -> None:
        self.resting = False
        self._woke_s = now_s
        self._players: frozenset[int] = frozenset()

    def update(
        self, now_s: float, players: frozenset[int], last_sound_s: float, *, heard: bool
    ) -> bool:
        """Return whether to rest.

        players: indexes of streams that may play; last_sound_s: time of the latest sound while
        awake; heard: whether sound was noticed while resting.
        """
        came = bool(players - self._players)
        self._players = players
        if came or (self.resting and heard):
            self.resting = False
            self._woke_s = now_s
        elif not self.resting and now_s - self._woke_s > AWAKE_S:
            self.resting = now_s - last_sound_s > (SILENT_S if players else QUIET_S)
        return self.resting

    def wake(self, now_s: float) -> None:
        """Wake, because of a change that concerns the streams."""
        self.resting = False
        self._woke_s = now_s

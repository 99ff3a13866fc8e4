"""Timing of the main thread: retries, stalls, suspends, idle state and wake-up."""

import math
import os
import select
from collections.abc import Callable
from contextlib import AbstractContextManager

from audioflinger_hook.service.state import Cause, StateKeeper

FIRST_S, LONGEST_S = 0.05, 0.5  # first and, by default, longest wait between attempts

STALLED_S = 1.0  # lateness of a tick that counts as a stall of the process
SLEPT_S = 0.5  # shortest suspend that counts

QUIET_S = 5.0  # silence before the idle state if no stream plays
# Silence before the idle state while a stream plays. No event announces the stream's next sound,
# and the beginning of this sound is lost.
SILENT_S = 10.0
AWAKE_S = 8.0  # shortest time between idle states, because streams may open before they play


class Backoff:
    """Computes waits between attempts: FIRST_S, doubled by each failure, at most `longest_s`."""

    def __init__(self, longest_s: float = LONGEST_S) -> None:
        self._longest_s = longest_s
        self._next_wait_s = FIRST_S
        self._due_s = -math.inf

    def failed(self, now_s: float) -> float:
        """Count a failure; return the seconds to wait from `now_s` on."""
        wait_s = self._next_wait_s
        self._next_wait_s = min(self._longest_s, 2.0 * wait_s)
        self._due_s = now_s + wait_s
        return wait_s

    def succeeded(self) -> None:
        """Reset, so that the next attempt is due immediately."""
        self._next_wait_s, self._due_s = FIRST_S, -math.inf

    def wait_s(self, now_s: float) -> float:
        """Return the seconds until the next attempt; 0 if it is due."""
        # If the clock is set back, the wait must not become longer.
        return min(self._longest_s, max(0.0, self._due_s - now_s))


class StallDetector:
    """Counts stalls of the process and suspends of the machine between ticks."""

    def __init__(self, states: StateKeeper, slept_s: Callable[[], float]) -> None:
        self._states, self._slept, self._slept_s = states, slept_s, slept_s()
        self._ticked_s: float | None = None
        self._resyncs = 0

    def woke(self, now_s: float, rest_s: float) -> bool:
        """Return whether a suspend followed the last tick; if not, count a late tick as a stall."""
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
        """Count new restarts of the delay line. resyncs: total number of restarts."""
        for _ in range(resyncs - self._resyncs):
            self._states.count(Cause.RESYNC, "processing fell behind; delay reset")
        self._resyncs = resyncs


class IdlePolicy:
    """Decides when streams are closed during silence. resting: whether to close them."""

    def __init__(self, now_s: float) -> None:
        self.resting, self._woke_s = False, now_s
        self._players: frozenset[int] = frozenset()

    def update(
        self, now_s: float, players: frozenset[int], last_sound_s: float, *, heard: bool
    ) -> bool:
        """Return whether to close the streams. players: indexes of the streams that play.

        heard: whether `Input.listen` detected sound.
        """
        came = bool(players - self._players)
        self._players = players
        if came or (self.resting and heard):
            self.wake(now_s)
        elif not self.resting and now_s - self._woke_s > AWAKE_S:
            self.resting = now_s - last_sound_s > (SILENT_S if players else QUIET_S)
        return self.resting

    def wake(self, now_s: float) -> None:
        """End the idle state after a change that concerns the streams."""
        self.resting, self._woke_s = False, now_s


class Wake(AbstractContextManager["Wake"]):
    """A wake-up event: `ring` ends the current or next `wait`.

    Any thread or signal handler may call `ring`, repeatedly. One thread calls `wait`.
    """

    def __init__(self) -> None:
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._bell, select.POLLIN)

    def ring(self) -> None:
        """End a `wait`. The call takes no lock and never blocks. After `close`, it does nothing."""
        if self._bell >= 0:
            os.eventfd_write(self._bell, 1)

    def wait(self, limit_s: float) -> bool:
        """Wait for a ring, at most `limit_s` seconds; return whether there was a ring."""
        if not self._poll.poll(max(0.0, limit_s) * 1e3):
            return False
        os.eventfd_read(self._bell)
        return True

    def close(self) -> None:
        """Close the descriptor. Repeated calls do nothing."""
        bell, self._bell = self._bell, -1
        if bell >= 0:
            os.close(bell)

    def __exit__(self, *_: object) -> None:
        self.close()

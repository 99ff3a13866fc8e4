"""Time until the next attempt: short at first, doubled after each failure."""

from __future__ import annotations

FIRST_S = 0.05
LONGEST_S = 2.0


class Backoff:
    """Waits between attempts: FIRST_S, doubled after every failure, `longest_s` at most.

    Times are seconds of any one clock. Not to be used from two threads at once.
    """

    def __init__(self, longest_s: float = LONGEST_S) -> None:
        self._longest_s = longest_s
        self._next_wait_s = FIRST_S
        self._due_s: float | None = None

    def failed(self, now_s: float) -> float:
        """Count a failure; return the wait from `now_s` on."""
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

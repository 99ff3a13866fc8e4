"""Time until the next attempt: short at first, doubled after each failure."""

from __future__ import annotations

FIRST_S = 0.05
LONGEST_S = 2.0


class Backoff:
    """Waits between attempts: `first_s`, doubled after every failure, `longest_s` at most.

    Times are seconds of any one clock. Not to be used from two threads at once.
    """

    def __init__(self, first_s: float = FIRST_S, longest_s: float = LONGEST_S) -> None:
        if not 0.0 < first_s <= longest_s:
            raise ValueError(
                f"waits from {first_s} to {longest_s} s; allowed: 0 < first <= longest"
            )
        self._first_s = first_s
        self._longest_s = longest_s
        self._next_wait_s = first_s
        self._due_s: float | None = None
        self.failures = 0
        """Failures since the last success."""

    def failed(self, now_s: float) -> float:
        """Count a failure; return the wait from `now_s` on."""
        wait_s = self._next_wait_s
        self._next_wait_s = min(self._longest_s, 2.0 * wait_s)
        self._due_s = now_s + wait_s
        self.failures += 1
        return wait_s

    def succeeded(self) -> None:
        """Reset: the next attempt is due at once."""
        self._next_wait_s = self._first_s
        self._due_s = None
        self.failures = 0

    def wait_s(self, now_s: float) -> float:
        """Return the seconds until the next attempt; 0 if it is due."""
        if self._due_s is None:
            return 0.0
        # If the clock is set back, the wait must not become longer.
        return min(self._longest_s, max(0.0, self._due_s - now_s))

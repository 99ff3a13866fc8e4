"""When to try again: soon at first, then ever less often."""

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
        """Take in a failure; return how long to wait from `now_s` on."""
        wait_s = self._next_wait_s
        self._next_wait_s = min(self._longest_s, 2.0 * wait_s)
        self._due_s = now_s + wait_s
        self.failures += 1
        return wait_s

    def succeeded(self) -> None:
        """Begin anew: the next attempt is due at once, the wait after it is the first one."""
        self._next_wait_s = self._first_s
        self._due_s = None
        self.failures = 0

    def wait_s(self, now_s: float) -> float:
        """Return how long to wait at `now_s` until the next attempt is due; 0 if it is."""
        if self._due_s is None:
            return 0.0
        # A clock that was set back must not prolong a wait.
        return min(self._longest_s, max(0.0, self._due_s - now_s))

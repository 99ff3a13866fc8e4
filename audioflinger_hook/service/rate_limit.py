"""How often the same may be said: a few times at once, then now and then, with a count."""

from __future__ import annotations

from collections.abc import Hashable

AT_ONCE = 5
"""So often something may be said without a pause."""

EVERY_S = 10.0
"""So often in the long run."""

KINDS_MAX = 100
"""What is said is of a few kinds; more than these are taken for one."""


class RateLimit:
    """Says of each kind of message whether it may be said now, and how many before it were not.

    Times are seconds of any one clock. Not to be used from two threads at once. The memory used
    does not grow.
    """

    def __init__(self, at_once: int = AT_ONCE, every_s: float = EVERY_S) -> None:
        if at_once < 1 or not every_s > 0.0:
            raise ValueError(
                f"{at_once} at once, one every {every_s} s; allowed: 1 or more, above 0"
            )
        self._at_once = at_once
        self._every_s = every_s
        # How many may be said, as of when, and how many were left out since one was.
        self._kinds: dict[Hashable, tuple[float, float, int]] = {}

    def left_out(self, kind: Hashable, now_s: float) -> int | None:
        """Return how many were left out before this one, or None where this one is left out."""
        if kind not in self._kinds and len(self._kinds) >= KINDS_MAX:
            kind = None
        allowance, asked_s, missed = self._kinds.get(kind, (float(self._at_once), now_s, 0))
        gained = max(0.0, now_s - asked_s) / self._every_s
        allowance = min(float(self._at_once), allowance + gained)
        if allowance < 1.0:
            self._kinds[kind] = (allowance, now_s, missed + 1)
            return None
        self._kinds[kind] = (allowance - 1.0, now_s, 0)
        return missed

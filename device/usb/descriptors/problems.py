"""Violations of the specifications: place, value and allowed values; raised or collected.

A problem is text for people, in one line:

    offset 43, feature unit: source id 9 is of no unit or terminal; allowed: 1, 3 or 5

Strict reading raises the first as a `DescriptorError`; forgiving reading collects the same texts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from device.errors import UsageError

PROBLEMS_MAX = 200
"""Problems collected from one configuration, enough for a bug report."""


class DescriptorError(UsageError):
    """Descriptors, or a dump of them, cannot be read or, in strict mode, violate the standard."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One deviation from the specifications; `str()` of it is what a user sees.

    offset: bytes from the first that were given to the descriptor; descriptor: its name;
    found: what it says; allowed: what it may say.
    """

    offset: int
    descriptor: str
    found: str
    allowed: str

    def __str__(self) -> str:
        return f"offset {self.offset}, {self.descriptor}: {self.found}; allowed: {self.allowed}"


class Findings:
    """Collects problems, or raises the first one in strict mode."""

    def __init__(self, strict: bool = False) -> None:
        self._strict = strict
        self._problems: list[Problem] = []
        self._more = 0

    def note(self, offset: int, descriptor: str, found: str, allowed: str) -> None:
        """Take one problem.

        DescriptorError: in strict mode, always.
        """
        if self._strict:
            raise DescriptorError(str(Problem(offset, descriptor, found, allowed)))
        if len(self._problems) < PROBLEMS_MAX:
            self._problems.append(Problem(offset, descriptor, found, allowed))
        else:
            self._more += 1

    def problems(self) -> tuple[Problem, ...]:
        """Return the problems in order; the last one counts those beyond the maximum."""
        if not self._more:
            return tuple(self._problems)
        more = Problem(0, "configuration", f"{self._more} more problems", "none")
        return (*self._problems, more)


def listed(ids: Iterable[int], most: int = 16) -> str:
    """The ids in words: "1, 2 or 5"; "none" without any, the first `most` of many."""
    words = [str(number) for number in sorted(ids)]
    if len(words) > most:
        return f"{', '.join(words[:most])} ..."
    if len(words) < 2:
        return words[0] if words else "none"
    return f"{', '.join(words[:-1])} or {words[-1]}"

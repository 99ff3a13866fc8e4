"""Limits of single values, with the words that a message says them in."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Limit:
    """Whether a value is allowed, and what it must be: "above 0"."""

    test: Callable[[Any], bool]
    words: str

    def allows(self, value: object) -> bool:
        """Whether the value is allowed; one of a type that cannot be tested is not."""
        try:
            return not isinstance(value, bool) and self.test(value)
        except (TypeError, OverflowError):  # a word; a whole number beyond all floats
            return False


POSITIVE = Limit(lambda value: math.isfinite(value) and value > 0, "above 0")
NOT_NEGATIVE = Limit(lambda value: math.isfinite(value) and value >= 0, "0 or more")
NOT_POSITIVE = Limit(lambda value: math.isfinite(value) and value <= 0, "0 or less")
UP_TO_INFINITY = Limit(lambda value: value > 0, "above 0, or inf")
SHARE = Limit(lambda value: 0 <= value < 1, "from 0 to below 1")


def whole(lowest: int, highest: int) -> Limit:
    """A whole number in a range, both ends allowed."""
    return Limit(
        lambda value: isinstance(value, int) and lowest <= value <= highest,
        f"a whole number, {lowest} to {highest}",
    )


def one_of(*words: str) -> Limit:
    """One of some words."""
    return Limit(lambda value: value in words, " or ".join(repr(word) for word in words))

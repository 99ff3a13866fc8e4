"""The level in dB of each step of a volume control, from the driver's table. Pure functions.

A table is a list of 32-bit words: its kind, the length of its content in bytes, then its content
(<sound/tlv.h> of the kernel). Levels in a table are integers in units of 0.01 dB.
"""

import bisect
import math
from collections.abc import Callable, Sequence
from ctypes import c_int32
from dataclasses import dataclass

_CONTAINER, _SCALE, _LINEAR, _RANGE, _BOUNDS, _BOUNDS_MUTE = range(6)
_SILENT_WHEN_LOWEST = 0x10000
_SILENT = -9_999_999  # lower end of a linear table that means silence

_ABSURD = 100_000  # limit that prevents overflow; no card amplifies by 1000 dB
_PER_DB = 100.0
_DEEPEST = 4  # greatest accepted depth of nested tables

Level = Callable[[int], float]  # the level of a step in dB


@dataclass(frozen=True)
class Decibels:
    """The level in dB of each step of a volume control, `lowest` to `highest`; -inf is silence."""

    lowest: int
    highest: int
    level: Level  # does not decrease with the step unless the driver is faulty

    @property
    def lowest_db(self) -> float:
        """The level of the lowest step in dB."""
        return self.level(self.lowest)

    @property
    def highest_db(self) -> float:
        """The level of the highest step in dB."""
        return self.level(self.highest)

    def step_at_most(self, wanted_db: float) -> int | None:
        """Return the highest step with a level of at most wanted_db; None if there is none."""
        steps = range(self.lowest, self.highest + 1)
        place = bisect.bisect_right(steps, wanted_db + 1e-9, key=self.level)
        return steps[place - 1] if place else None


def parse_decibels(words: Sequence[int], lowest: int, highest: int) -> Decibels | None:
    """Return the levels that a table of unsigned 32-bit words gives; None if it is invalid."""
    level = _level(list(words), lowest, highest, 0)
    if level is None or not level(lowest) <= level(highest):
        return None
    return Decibels(lowest, highest, level)


def _level(words: list[int], lowest: int, highest: int, depth: int) -> Level | None:
    if len(words) < 2 or lowest >= highest or depth > _DEEPEST:
        return None
    kind, body = words[0], words[2 : 2 + words[1] // 4]
    if len(body) < words[1] // 4:
        return None
    if kind == _CONTAINER:
        while len(body) >= 2:
            if (level := _level(body, lowest, highest, depth + 1)) is not None:
                return level
            body = body[2 + (body[1] + 3) // 4 :]
        return None
    if kind == _RANGE:
        return _pieces(body, depth)
    if len(body) < 2:
        return None
    first, second = (c_int32(word).value for word in body[:2])
    if kind == _SCALE:
        return _even(first, body[1] & 0xFFFF, 1, lowest, bool(body[1] & _SILENT_WHEN_LOWEST))
    if kind == _LINEAR:
        return _linear(first, second, lowest, highest)
    if kind in (_BOUNDS, _BOUNDS_MUTE):
        return _even(first, second - first, highest - lowest, lowest, kind == _BOUNDS_MUTE)
    return None


def _pieces(body: list[int], depth: int) -> Level | None:
    """Return one level function for consecutive ranges of steps. body: ranges with their tables."""
    found: list[tuple[int, Level]] = []
    while len(body) >= 4:
        first, last = (c_int32(word).value for word in body[:2])
        # Evaluate a table of a single step as the lower of two steps.
        level = _level(body[2:], first, max(last, first + 1), depth + 1) if first <= last else None
        if level is None:
            return None
        found.append((last, level))
        body = body[4 + (body[3] + 3) // 4 :]
    if not found:
        return None
    last, highest = found[-1]
    return lambda step: next((one(step) for end, one in found if step <= end), highest(last))


def _even(first: int, rise: int, steps: int, lowest: int, silent: bool) -> Level:
    """Return a level function that is linear in dB. rise: over `steps` steps, in 0.01 dB."""
    return lambda step: (
        -math.inf
        if silent and step <= lowest
        else (first + rise * (step - lowest) / steps) / _PER_DB
    )


def _linear(first: int, last: int, lowest: int, highest: int) -> Level:
    """Return a level function that is linear in amplitude. first, last: levels in 0.01 dB."""
    quiet = 0.0 if first <= _SILENT else 10.0 ** (min(first, _ABSURD) / _PER_DB / 20.0)
    loud = 10.0 ** (min(last, _ABSURD) / _PER_DB / 20.0)

    def level(step: int) -> float:
        amplitude = quiet + (loud - quiet) * (step - lowest) / (highest - lowest)
        return 20.0 * math.log10(amplitude) if amplitude > 0.0 else -math.inf

    return level

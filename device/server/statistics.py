"""How long something takes, over any number of occasions, in a fixed amount of memory."""

from __future__ import annotations

import math
from dataclasses import dataclass

_PER_OCTAVE = 8
_OCTAVES = 30
_BINS = _PER_OCTAVE * _OCTAVES + 1


@dataclass(frozen=True)
class Summary:
    """Durations so far: how many, and median, 99th percentile and longest in microseconds."""

    count: int
    median_us: float
    p99_us: float
    max_us: float


class Durations:
    """Counts durations in bins of 9 %, from 1 us to 18 minutes.

    One thread adds; any thread may read `summary` meanwhile, which may then miss the latest one.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._bins = [0] * _BINS
        self._count = 0
        self._max_ns = 0

    def add(self, duration_ns: int) -> None:
        """Count one duration in nanoseconds; what is under 1 us counts as 1 us."""
        if duration_ns > 1_000:
            place = min(int(_PER_OCTAVE * math.log2(duration_ns / 1_000)) + 1, _BINS - 1)
        else:
            place = 0
        self._bins[place] += 1
        self._count += 1
        if duration_ns > self._max_ns:
            self._max_ns = duration_ns

    def summary(self) -> Summary:
        """The summary; percentiles are the upper edges of their bins, all 0 before the first."""
        longest_us = self._max_ns / 1_000
        bins = list(self._bins)
        count = sum(bins)
        if not count:
            return Summary(0, 0.0, 0.0, 0.0)
        return Summary(
            count,
            min(_percentile_us(bins, count, 0.5), longest_us),
            min(_percentile_us(bins, count, 0.99), longest_us),
            longest_us,
        )


def _percentile_us(bins: list[int], count: int, share: float) -> float:
    """The upper edge in us of the bin that holds this share of all."""
    seen = 0
    for place, number in enumerate(bins):
        seen += number
        if seen >= share * count:
            return float(2.0 ** (place / _PER_OCTAVE))
    return float(2.0**_OCTAVES)

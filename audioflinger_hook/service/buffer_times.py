"""How long buffers take: a histogram of fixed size, and what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass

SHORTEST_S = 1e-6
LONGEST_S = 10.0
STEP = 1.04
"""Each bin reaches 4 % further than the one before: how exact a percentile is."""

BINS = math.ceil(math.log(LONGEST_S / SHORTEST_S) / math.log(STEP)) + 1
_BINS_PER_E = 1.0 / math.log(STEP)


@dataclass(frozen=True)
class BufferTimes:
    """What buffers took, in ms: half of them at most p50, 99 % at most p99, the longest max.

    buffer_ms: the time that the last buffer plays; share_percent: of all time played, how much
    was spent on computing. All 0 before the first buffer.
    """

    p50_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0
    buffer_ms: float = 0.0
    share_percent: float = 0.0


class BufferClock:
    """The times of all buffers so far, in memory that does not grow.

    One thread (the audio thread may) calls `add`; any thread may call `times`.
    """

    def __init__(self) -> None:
        self._counts = [0] * BINS
        self._max_s = 0.0
        self._busy_s = 0.0
        self._played_s = 0.0
        self._buffer_s = 0.0

    def add(self, busy_s: float, buffer_s: float) -> None:
        """Take in a buffer that took `busy_s` and plays for `buffer_s`."""
        busy_s = max(0.0, busy_s)
        ratio = min(busy_s, LONGEST_S) / SHORTEST_S
        index = math.ceil(math.log(ratio) * _BINS_PER_E) if ratio > 1.0 else 0
        self._counts[min(index, BINS - 1)] += 1
        self._max_s = max(self._max_s, busy_s)
        self._busy_s += busy_s
        self._played_s += buffer_s
        self._buffer_s = buffer_s

    def times(self) -> BufferTimes:
        """Return what the buffers took; percentiles are at most 4 % too long, never too short."""
        counts = self._counts.copy()
        longest_s = self._max_s
        total = sum(counts)
        if not total:
            return BufferTimes()
        return BufferTimes(
            p50_ms=1e3 * min(longest_s, _percentile_s(counts, total, 0.50)),
            p99_ms=1e3 * min(longest_s, _percentile_s(counts, total, 0.99)),
            max_ms=1e3 * longest_s,
            buffer_ms=1e3 * self._buffer_s,
            share_percent=100.0 * self._busy_s / self._played_s if self._played_s else 0.0,
        )


def _percentile_s(counts: list[int], total: int, share: float) -> float:
    """Return the upper edge of the bin in which the share is reached; inf for the last one."""
    needed = math.ceil(share * total)
    seen = 0
    for index, count in enumerate(counts):
        seen += count
        if seen >= needed:
            return SHORTEST_S * STEP**index if index < BINS - 1 else math.inf
    return math.inf

"""Timing: what a piece of work costs one thread, beside a unit of cost timed with it.

CPU time of the calling thread (`time.thread_time`), so that what other programs do counts only
through caches and clock frequency; against those the unit is timed right before every
measurement, and ratios to it are taken pair by pair.

Seconds say what a cost is here and now. From machine to machine, and from minute to minute on one
that is shared, only the ratio travels: so limits of time are asked in units of the FFT too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import rfft

from audioflinger_hook.transform import FloatArray, Frames

RFFT_FRAMES = 2048
RFFT_CALLS = 100
"""Calls in one timing of the unit: about a millisecond, far over the clock's step."""
LIMITS_RFFT_S = 7.7e-6
"""What the unit took on the machine that the limits of time were set on."""

_UNIT_INPUT = np.random.default_rng(0).standard_normal(RFFT_FRAMES).astype(np.float32)


def rfft_unit_s() -> float:
    """Return the unit of cost: thread CPU seconds of one scipy.fft.rfft(2048, float32)."""
    rfft(_UNIT_INPUT)
    start = time.thread_time()
    for _ in range(RFFT_CALLS):
        rfft(_UNIT_INPUT)
    return (time.thread_time() - start) / RFFT_CALLS


def in_ffts(limit_s: float) -> float:
    """Return a limit of time, s, as a limit of cost in units of the rfft, to three digits.

    It asks of every machine what the limit of time asks of the one that it was set on.
    """
    return float(f"{limit_s / LIMITS_RFFT_S:.3g}")


def thread_seconds(work: Callable[[], object]) -> float:
    """Return the thread CPU seconds of one call."""
    start = time.thread_time()
    work()
    return time.thread_time() - start


@dataclass
class Timings:
    """Repeated timings of one piece of work: seconds, and the same in units of the rfft."""

    seconds: list[float] = field(default_factory=list)
    units: list[float] = field(default_factory=list)

    @property
    def median_s(self) -> float:
        """The median in seconds."""
        return float(np.median(self.seconds))

    @property
    def median_units(self) -> float:
        """The median of the ratios to the unit timed with each."""
        return float(np.median(self.units))


def interleaved(
    works: Sequence[Callable[[], object]],
    repeats: int | Sequence[int],
    before: Sequence[Callable[[], object]] | None = None,
    *,
    warm: bool = True,
) -> list[Timings]:
    """Return the timings of several works, in turns: each round runs every one of them once.

    warm: one round before the first warms caches and is not counted; works that last long need
    none. repeats: of all of them, or of
    each; those with fewer sit out rounds evenly from first to last. before: for each work, what
    has to be done before every run of it and is not timed.
    """
    timings = [Timings() for _ in works]
    firsts = before or [_nothing] * len(works)
    counts = [repeats] * len(works) if isinstance(repeats, int) else list(repeats)
    rounds = max(counts, default=0)
    if warm:
        for first, work in zip(firsts, works, strict=True):
            first()
            work()
    for turn in range(rounds):
        for first, work, kept, count in zip(firsts, works, timings, counts, strict=True):
            if (turn + 1) * count // rounds == turn * count // rounds:
                continue
            first()
            unit_s = rfft_unit_s()
            seconds = thread_seconds(work)
            kept.seconds.append(seconds)
            kept.units.append(seconds / unit_s)
    return timings


def call_times_s(
    work: Callable[[Frames], object],
    blocks: Sequence[Frames],
    before: Callable[[], object] | None = None,
) -> FloatArray:
    """Return the thread CPU seconds of each call on a block, (blocks,); before: done untimed."""
    times = np.empty(len(blocks))
    for index, block in enumerate(blocks):
        if before:
            before()
        start = time.thread_time()
        work(block)
        times[index] = time.thread_time() - start
    return times


def _nothing() -> None:
    """Prepare nothing."""

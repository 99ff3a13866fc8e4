"""Timing: what a piece of work costs one thread, beside a unit of cost that is timed with it.

Costs are CPU time of the calling thread (`time.thread_time`). The unit, one FFT, is timed right
before every measurement, and ratios are taken pair by pair. Seconds depend on the machine and its
load; the ratio hardly does. So limits of time are also set in units of the FFT.
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

Work = Callable[[], object]

_UNIT_INPUT = np.random.default_rng(0).standard_normal(RFFT_FRAMES).astype(np.float32)


def rfft_unit_s() -> float:
    """Return the unit of cost: thread CPU seconds of one scipy.fft.rfft(2048, float32)."""
    rfft(_UNIT_INPUT)
    start = time.thread_time()
    for _ in range(RFFT_CALLS):
        rfft(_UNIT_INPUT)
    return (time.thread_time() - start) / RFFT_CALLS


def in_ffts(limit_s: float) -> float:
    """Return a limit of time, s, as a limit in units of the FFT, to three digits."""
    return float(f"{limit_s / LIMITS_RFFT_S:.3g}")


def thread_seconds(work: Work) -> float:
    """Return the thread CPU seconds of one call."""
    start = time.thread_time()
    work()
    return time.thread_time() - start


@dataclass
class Timings:
    """Repeated timings of one piece of work: seconds, and the same in units of the FFT."""

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
    works: Sequence[Work],
    repeats: int | Sequence[int],
    before: Sequence[Work] | None = None,
    *,
    warm: bool = True,
) -> list[Timings]:
    """Return the timings of several works; each round runs every one of them once.

    repeats: of all works, or of each; a work with fewer skips rounds evenly. before: what runs
    untimed before every run of each work. warm: one round runs first and is not counted.
    """
    timings = [Timings() for _ in works]
    firsts = before or [lambda: None] * len(works)
    counts = [repeats] * len(works) if isinstance(repeats, int) else list(repeats)
    rounds = max(counts, default=0)
    if warm:
        for first, work in zip(firsts, works, strict=True):
            first()
            work()
    for turn in range(rounds):
        for first, work, kept, count in zip(firsts, works, timings, counts, strict=True):
            if (turn + 1) * count // rounds > turn * count // rounds:
                first()
                unit_s = rfft_unit_s()
                seconds = thread_seconds(work)
                kept.seconds.append(seconds)
                kept.units.append(seconds / unit_s)
    return timings


def call_times_s(
    work: Callable[[Frames], object], blocks: Sequence[Frames], before: Work | None = None
) -> FloatArray:
    """Return the thread CPU seconds of each call on a block, (blocks,); before: runs untimed."""
    times = np.empty(len(blocks))
    for index, block in enumerate(blocks):
        if before:
            before()
        start = time.thread_time()
        work(block)
        times[index] = time.thread_time() - start
    return times

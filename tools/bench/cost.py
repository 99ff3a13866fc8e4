"""CPU time of work on one thread, in seconds and relative to the CPU time of one FFT.

The function `interleaved` measures the time of FFTs of 2048 samples directly before each
measurement of other work. Times in seconds depend on the machine and its load. Their ratio to the
time of an FFT is nearly constant. Upper limits of CPU time are therefore also given as numbers of
FFTs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import rfft

from audioflinger_hook.transform import FloatArray, Frames

RFFT_FRAMES = 2048
RFFT_CALLS = 100  # FFTs in one timing, which takes about 1 ms
LIMITS_RFFT_S = 7.7e-6  # CPU time in s of one FFT on the machine for which time limits were set

Work = Callable[[], object]

_UNIT_INPUT = np.random.default_rng(0).standard_normal(RFFT_FRAMES).astype(np.float32)


def rfft_unit_s() -> float:
    """Return the CPU time in s of one scipy.fft.rfft of 2048 float32 samples."""
    rfft(_UNIT_INPUT)
    start = time.thread_time()
    for _ in range(RFFT_CALLS):
        rfft(_UNIT_INPUT)
    return (time.thread_time() - start) / RFFT_CALLS


def in_ffts(limit_s: float) -> float:
    """Convert a time limit in s to a number of FFTs of 7.7 µs, with three significant digits."""
    return float(f"{limit_s / LIMITS_RFFT_S:.3g}")


def thread_seconds(work: Work) -> float:
    """Return the CPU time in s of one call of `work`."""
    start = time.thread_time()
    work()
    return time.thread_time() - start


@dataclass
class Timings:
    """Repeated timings of the same work.

    seconds: CPU times in s.
    units: CPU times divided by the time of one FFT.
    """

    seconds: list[float] = field(default_factory=list)
    units: list[float] = field(default_factory=list)

    @property
    def median_s(self) -> float:
        """The median CPU time in s."""
        return float(np.median(self.seconds))

    @property
    def median_units(self) -> float:
        """The median of `units`."""
        return float(np.median(self.units))


def interleaved(
    works: Sequence[Work],
    repeats: int | Sequence[int],
    before: Sequence[Work] | None = None,
    *,
    warm: bool = True,
) -> list[Timings]:
    """Time several functions in turn, and return the timings of each function.

    works: functions to time.
    repeats: number of timings of each function; one number for all, or one for each.
    before: for each of `works`, a function to call before each timing; it is not timed.
    warm: whether to call each function once before the timings.
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
    """Return the CPU time in s of one call of `work` for each block, (blocks,).

    before: function to call before each block; it is not timed.
    """
    times = np.empty(len(blocks))
    for index, block in enumerate(blocks):
        if before:
            before()
        start = time.thread_time()
        work(block)
        times[index] = time.thread_time() - start
    return times

"""What work costs; times in a unit that travels: seconds would say how busy the machine is."""

import time

import psutil

from tools.bench.cost import rfft_unit_s


def cost_ffts(work):
    """The processor time of a call over that of one FFT, to be compared with `in_ffts` of a limit.

    The FFT is timed before and after: whatever slows the machine meanwhile slows the work as well.
    """
    before_s = rfft_unit_s()
    start_s = time.process_time()
    work()
    spent_s = time.process_time() - start_s
    return spent_s / max(before_s, rfft_unit_s())


def resident_bytes(pid: int | None = None) -> int:
    """Return the memory that a process occupies now, by default this one."""
    return int(psutil.Process(pid).memory_info().rss)

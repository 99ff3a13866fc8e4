"""The CPU time of the calling thread, for cost figures."""

import time


def cpu_time_s() -> float:
    """Return the CPU time of this thread in seconds; only differences have a meaning."""
    return time.thread_time()

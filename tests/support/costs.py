"""What work costs, in a unit that travels: a limit in seconds would say how busy the machine is."""

import time

from tools.bench.cost import rfft_unit_s


def cost_ffts(work):
    """The processor time of a call as a multiple of that of one rfft(2048, float32).

    The FFT is timed before and after; the slower of the two counts, as whatever slows the machine
    down meanwhile slows the work as well. Compare with `in_ffts` of a limit in seconds.
    """
    before_s = rfft_unit_s()
    start_s = time.process_time()
    work()
    spent_s = time.process_time() - start_s
    return spent_s / max(before_s, rfft_unit_s())

"""What work costs, in a unit that travels: a limit in seconds would say how busy the machine is."""

import time

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

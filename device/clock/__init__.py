"""Two clocks made one: the tap's frames, delayed by a known time, at the pace of the output.

    write -> ring -> interpolator -> declick -> read
               |          ^
             timing -> rate loop <- timing

Nothing in this package reads a clock, starts a thread, waits or does I/O: time comes in as an
argument, in seconds of one monotonic clock.
"""

from device.clock.delay_line import DelayLine
from device.clock.status import DelayState, DelayStatus

__all__ = ["DelayLine", "DelayState", "DelayStatus"]

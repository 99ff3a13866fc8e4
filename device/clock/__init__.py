"""A delay line between two sample clocks: input frames at the output's rate, at a fixed delay.

    write -> ring -> interpolator -> playhead -> read
               |          ^
         frame clock -> delay control <- frame clock

| module | contents |
| --- | --- |
| `delay_line` | `DelayLine`: writes, reads and their states |
| `arrivals` | the writing side: frames and the times of their capture |
| `ring` | the newest frames, for a reader that never waits |
| `playhead` | the read position, with a short fade at every discontinuity |
| `interpolator` | reads frames at a ratio that is not whole |
| `delay_control` | the target delay, and the loop that steers to it |
| `frame_clock` | a stream's true rate and phase, from jittery callback times |
| `stream_timing` | a stream's clock and how late its callbacks come |
| `shared_state` | values that both sides and the status share |

Nothing here reads a clock, starts a thread, waits or does I/O. Times are arguments, in seconds of
one monotonic clock.
"""

from device.clock.delay_line import DelayLine
from device.clock.shared_state import DelayState, DelayStatus

__all__ = ["DelayLine", "DelayState", "DelayStatus"]

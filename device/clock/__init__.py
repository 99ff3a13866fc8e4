"""Delays frames by a fixed time, and converts them from one sample clock to another.

    write -> ring -> read
               ^
    clock -> delay control <- clock

| module | contents |
| --- | --- |
| `delay_line` | `DelayLine`: a ring buffer read at any ratio, with a fade at every discontinuity |
| `delay_control` | the states, the target delay, and the control loop for the delay |
| `stream_timing` | the clock of a stream, and the lateness of its callbacks |
| `frame_clock` | a stream's true rate and phase, from jittery callback times |

Nothing here reads a clock, starts a thread, waits or does I/O. Times are arguments, in seconds of
one monotonic clock.
"""

from device.clock.delay_control import DelayState
from device.clock.delay_line import DelayLine

__all__ = ["DelayLine", "DelayState"]

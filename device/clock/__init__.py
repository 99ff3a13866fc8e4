"""A delay line between two sample clocks: input frames at the output's rate, at a fixed delay.

    write -> ring -> read
               ^
    clock -> delay control <- clock

| module | contents |
| --- | --- |
| `delay_line` | `DelayLine`: writes, reads and their states |
| `ring` | the newest frames, read at any ratio, with a short fade at every discontinuity |
| `delay_control` | the target delay, and the loop that steers to it |
| `stream_timing` | each side's clock, and how late its callbacks come |
| `frame_clock` | a stream's true rate and phase, from jittery callback times |

Nothing here reads a clock, starts a thread, waits or does I/O. Times are arguments, in seconds of
one monotonic clock.
"""

from device.clock.delay_line import DelayLine, DelayState

__all__ = ["DelayLine", "DelayState"]

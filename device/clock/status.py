"""What a delay line tells about itself."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class DelayState(enum.Enum):
    """Where a delay line stands. Every recovery leads through FILLING or STARVED."""

    EMPTY = "empty"
    """Nothing has been written since the start or the last flush; reads give silence."""
    FILLING = "filling"
    """Frames come in, but not yet enough for the target, or a clock is not yet known."""
    SETTLING = "settling"
    """Playing; the delay is being steered to the target."""
    LOCKED = "locked"
    """Playing; the delay has been on the target for a second."""
    STARVED = "starved"
    """The frames ran out; reads give silence until the target is filled again."""


@dataclass(frozen=True)
class DelayStatus:
    """One consistent picture of a delay line, as of the last read.

    target_s, delay_s: time from the capture of a frame to its place in the output, latencies of
    the sound cards themselves not included; delay_s is 0 unless SETTLING or LOCKED.
    ratio_ppm: how much faster than nominal the frames are read, -2000 to 2000, and up to 1000 more
    while the target moves.
    resyncs: jumps because the delay was too far from the target to be steered, those left out that
    the user's own change of it asks for.
    underflows: times the frames ran out. overflows: times frames were lost before they were read.
    silenced: True between `DelayLine.silence` and `DelayLine.resume`.
    """

    target_s: float
    delay_s: float
    ratio_ppm: float
    resyncs: int
    underflows: int
    overflows: int
    state: DelayState
    silenced: bool

"""Values that the threads of a delay line share, each handed over in one assignment."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple

from device.clock.frame_clock import ClockReading


class Written(NamedTuple):
    """What the writer publishes for the reader.

    frames: count written so far, as of `clock`. run_start: the first frame after the last stall;
    earlier frames are not played after it. lateness_s: what to provide for late callbacks.
    lateness_known: whether that was measured.
    """

    frames: int
    clock: ClockReading
    run_start: int
    lateness_s: float
    lateness_known: bool


class Flush:
    """A request to play none of the first `frames`; requests differ by identity."""

    def __init__(self, frames: int) -> None:
        self.frames = frames


class DelayState(enum.Enum):
    """The state of a delay line. Every recovery passes FILLING or STARVED."""

    EMPTY = "empty"
    """Nothing has been written since the start or the last flush; reads give silence."""
    FILLING = "filling"
    """Frames arrive, but there are too few for the target, or a clock is still unknown."""
    SETTLING = "settling"
    """Playing; the delay is being steered to the target."""
    LOCKED = "locked"
    """Playing; the delay has been on the target for a second."""
    STARVED = "starved"
    """The frames ran out; reads give silence until the target is filled again."""


@dataclass(frozen=True)
class DelayStatus:
    """One consistent picture of a delay line, as of the last read.

    Attributes
    ----------
    target_s : float
        The delay that is steered to, in seconds.
    delay_s : float
        From the capture of a frame to its place in the output, in seconds, without the latencies
        of the sound cards. It is 0 unless the state is SETTLING or LOCKED.
    ratio_ppm : float
        How much faster than nominal the frames are read: -2000 to 2000, and up to 1000 more while
        the target moves.
    resyncs : int
        Jumps because the delay was too far from the target. Jumps to a new offset do not count.
    underflows : int
        How often the frames ran out.
    overflows : int
        How often frames were lost before they were read.
    state : DelayState
        The state after that read.
    """

    target_s: float
    delay_s: float
    ratio_ppm: float
    resyncs: int
    underflows: int
    overflows: int
    state: DelayState

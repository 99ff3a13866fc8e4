"""What goes from one side of a delay line to the other, each in one assignment."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple

from device.clock.frame_clock import ClockReading


class Written(NamedTuple):
    """What the writer tells the reader.

    frames: written so far, as of `clock`. run_start: the first frame after the last stall; frames
    before it are not played after it. lateness_s: to provide for; known: whether it was measured.
    """

    frames: int
    clock: ClockReading
    run_start: int
    lateness_s: float
    lateness_known: bool


class Flush:
    """A wish to play none of the first `frames`; every one is another wish."""

    def __init__(self, frames: int) -> None:
        self.frames = frames


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

"""What goes from one side of a delay line to the other, each in one assignment."""

from __future__ import annotations

from typing import NamedTuple

from device.clock.timing import ClockReading


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

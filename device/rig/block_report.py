"""What the ladder says of each block that it has computed."""

from dataclasses import dataclass

from device.rig.rungs import Rung


@dataclass(frozen=True)
class BlockReport:
    """How one block was computed.

    frame: its first one since the start; frames; rung; estimate: of the error, as a share of the
    block's peak excursion or acceleration, 0 where a rung was asked for; excursion_peak_m.
    """

    frame: int
    frames: int
    rung: Rung
    estimate: float
    excursion_peak_m: float

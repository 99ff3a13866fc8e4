"""What the protection did and sees, for display."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ProtectionStatus:
    """Counts since the start or `reset`, and readings of the last block, the worst channel's.

    blocks: governed so far; limited_blocks: of those, where some drive was taken away;
    infeasible_blocks: where no gain kept every limit, and the drive was taken away altogether;
    replaced_samples: those that were not finite. gain: the smallest now, 0 to 1; least_gain: the
    smallest ever. limited_by: what asked for the gain now: "excursion, current or level",
    "temperature", "outside" (such as exposure), or "" where nothing did. excursion_m: amplitude of
    the swing that the energy in the believed model suffices for; coil_c: degrees C, and
    resistance_ohm, of the warmest coil, None where the rig does not say how it warms up;
    latency_s: what is added to the delay.
    """

    blocks: int
    limited_blocks: int
    infeasible_blocks: int
    replaced_samples: int
    gain: float
    least_gain: float
    limited_by: str
    excursion_m: float
    coil_c: float | None
    resistance_ohm: float | None
    latency_s: float

"""The limits of a rig, and the readings of its protection."""

import math
from dataclasses import dataclass

from device.rig import Rig
from device.rig.parameters import LargeSignalParameters

APPROACH_S = 2.0
"""Time constant with which a coil comes up to its limit of temperature."""

LIGHTEST_FRAME_KG = 0.57
"""A board that lies freely: it raises the resonance of 0.25 kg by a fifth."""


@dataclass(frozen=True)
class Limits:
    """Limits of a rig, each above 0 or None for no limit.

    excursion_m: in either direction; current_a: peak; level: of the vibration, 1.0 for full scale.
    deviation: share by which f0 (through the spring), moving mass and Bl may differ, 0 to 0.5.
    lightest_frame_kg: the frame may move freely and have this mass or more; inf: it stands still.
    stiffness_rise: see `LargeSignalParameters`.
    """

    excursion_m: float
    current_a: float | None = None
    coil_temperature_c: float | None = 120.0
    level: float = 1.0
    deviation: float = 0.1
    lightest_frame_kg: float = LIGHTEST_FRAME_KG
    stiffness_rise: float = LargeSignalParameters.stiffness_rise


def limits_of(rig: Rig) -> Limits:
    """Return the limits that follow from a rig.

    The limits are Xmax, the amplifier's current, and the level: full scale, or less if the
    amplifier clips before. If the rig describes how the coil warms up, the coil may reach 120 °C.
    The stiffening of the actuator is the rig's value, or a usual value. The frame may move freely
    even if the rig describes a seat, and may be as light as that seat.
    """
    full_scale_v = rig.dac.full_scale_v * rig.amplifier.gain
    current_a, large = rig.amplifier.current_limit_a, rig.large_signal
    return Limits(
        excursion_m=rig.actuator.x_max_m,
        current_a=None if math.isinf(current_a) else current_a,
        coil_temperature_c=Limits.coil_temperature_c if rig.thermal else None,
        level=min(1.0, rig.amplifier.output_limit_v / full_scale_v),
        lightest_frame_kg=min(LIGHTEST_FRAME_KG, rig.seat.mass_kg if rig.seat else math.inf),
        stiffness_rise=large.stiffness_rise if large else Limits.stiffness_rise,
    )


@dataclass(frozen=True)
class ProtectionStatus:
    """Counts, since the start or `reset`, and readings of the protection.

    blocks: all so far. limited_blocks: those in which the gain was below 1. infeasible_blocks:
    those in which no gain could keep every limit; the gain became 0. replaced_samples: those that
    were not finite. gain, least_gain: smallest of all channels, now and since the start; 0 to 1.
    limited_by: cause of the gain: "excursion, current or level", "temperature", "outside" (such as
    an exposure cap), or "". excursion_m: amplitude that the stored energy of the identified model
    could reach. coil_c, resistance_ohm: of the warmest coil, °C and ohm; None without a thermal
    model. latency_s: delay of the vibration.
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

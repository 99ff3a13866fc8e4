"""What a rig must not exceed, and what its protection did."""

import math
from dataclasses import dataclass

from device.rig import Rig
from device.rig.parameters import LargeSignalParameters


@dataclass(frozen=True)
class Limits:
    """Limits of a rig, each above 0 or None for no limit.

    excursion_m: in either direction; current_a: peak; level: of the vibration, 1.0 for full scale.
    detuning: share of f0 by which the rig may differ, 0 to 0.5.
    stiffness_rise, force_factor_loss: see `LargeSignalParameters`.
    """

    excursion_m: float
    current_a: float | None = None
    coil_temperature_c: float | None = 120.0
    level: float = 1.0
    detuning: float = 0.1
    stiffness_rise: float = LargeSignalParameters.stiffness_rise
    force_factor_loss: float = LargeSignalParameters.force_factor_loss


def limits_of(rig: Rig) -> Limits:
    """Return the limits that follow from a rig.

    Those are Xmax, the amplifier's current, and full scale or the level where the amplifier clips.
    The coil may have 120 °C if the rig says how it warms up. How much the actuator stiffens is
    what the rig says, or the usual value.
    """
    full_scale_v = rig.dac.full_scale_v * rig.amplifier.gain
    current_a, large = rig.amplifier.current_limit_a, rig.large_signal
    return Limits(
        excursion_m=rig.actuator.x_max_m,
        current_a=None if math.isinf(current_a) else current_a,
        coil_temperature_c=Limits.coil_temperature_c if rig.thermal else None,
        level=min(1.0, rig.amplifier.output_limit_v / full_scale_v),
        stiffness_rise=large.stiffness_rise if large else Limits.stiffness_rise,
        force_factor_loss=large.force_factor_loss if large else Limits.force_factor_loss,
    )


@dataclass(frozen=True)
class ProtectionStatus:
    """What the protection did and measures; counts since the start or `reset`.

    Attributes
    ----------
    blocks : int
        Blocks so far.
    limited_blocks : int
        Blocks in which the gain was below 1.
    infeasible_blocks : int
        Blocks in which no gain kept every limit, so that it became 0.
    replaced_samples : int
        Samples that were not finite.
    gain, least_gain : float
        Smallest of all channels now, and ever; 0 to 1.
    limited_by : str
        Cause of the gain: "excursion, current or level", "temperature", "outside" (such as an
        exposure cap), or "".
    excursion_m : float
        Amplitude for which the believed model's energy is enough.
    coil_c, resistance_ohm : float | None
        Of the warmest coil, in °C and ohm; None if the rig does not say how it warms up.
    latency_s : float
        Delay of the vibration.
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

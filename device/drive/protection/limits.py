"""The limits of a rig, models that bound each actuator it may have, and readings of its protection.

The true actuator may differ from the rig file in the stiffness of its spring, in its moving mass
and in Bl, and its frame may move. A frame of mass M that nothing holds makes the moving mass m
behave like m M / (m + M), and a seat lies between that and solid ground. So mass and stiffness
fill a rectangle. Two of its sides bound it: softest spring from the heaviest to the lightest mass,
then lightest mass up to the stiffest spring. At each resonance these are the models with the
broadest response. Linear programming over all drives shows that no actuator of the rectangle, with
any Bl, exceeds the models on these sides by more than `RESERVE`.
"""

import math
from dataclasses import dataclass

from device.rig import ActuatorParameters, Rig
from device.rig.parameters import LargeSignalParameters, vary

APPROACH_S = 2.0  # time constant with which a coil comes up to its limit of temperature

LIGHTEST_FRAME_KG = 0.57  # a board that lies freely: it raises the resonance of 0.25 kg by a fifth

RESERVE = 0.091  # share of the excursion kept for actuators between models, and for lower Bl

_SPACING = 0.24  # distance of two models, as the logarithm of the ratio of their resonances times Q
_MODELS_MAX = 24
_STRONGER = 0.75
"""Share of the possible rise of Bl that all models have, for the smallest reserve. The largest Bl
moves most outside of a resonance, the smallest at it."""


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

    The level is full scale, or less if the amplifier clips before. The coil may reach 120 °C, if
    the rig describes how it warms up. The frame may move freely even if the rig describes a seat,
    and may be as light as that seat.
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


def bounding_models(
    p: ActuatorParameters, limits: Limits, source_impedance_ohm: float
) -> list[ActuatorParameters]:
    """Return the actuator as believed, then the models that bound all that it may be."""
    d = limits.deviation
    lightest = 1.0 - d
    if math.isfinite(limits.lightest_frame_kg):
        on_frame = limits.lightest_frame_kg / p.moving_mass_kg
        lightest *= on_frame / (lightest + on_frame)
    softest, stiffest = (1.0 - d) ** 2, (1.0 + d) ** 2
    # A large swing stiffens the spring: over a sine, x^2 counts 3/4 of its peak.
    stiffest *= 1.0 + 0.75 * limits.stiffness_rise
    lowest, highest = math.sqrt(softest / (1.0 + d)), math.sqrt(stiffest / lightest)
    if highest <= lowest:
        return [p]
    span = math.log(highest / lowest)
    wanted = math.ceil(span * p.q_total(source_impedance_ohm) / _SPACING)
    steps = min(max(1, wanted), _MODELS_MAX)
    models = [p]
    for step in range(steps + 1):
        ratio = lowest * math.exp(span * step / steps)
        mass = max(lightest, softest / ratio**2)
        models.append(vary(p, mass, mass * ratio**2, 1.0 + _STRONGER * d))
    return models


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

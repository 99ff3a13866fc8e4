"""The limits of a rig, models that bound every possible actuator, and the protection's status.

The true actuator may differ from the rig file in stiffness, moving mass and Bl, and its frame may
move. A free frame of mass M changes the effective moving mass m to m M / (m + M). The effect of a
seat lies between the effects of a free frame and of solid ground. In a plot of stiffness over mass,
all possible actuators fill a rectangle. Models on two sides of this rectangle bound all responses:
the sides of the softest spring and of the lightest mass. Of all actuators with the same resonance
frequency, the one on these sides has the broadest resonance. Linear programming over all signals
shows that no actuator exceeds the largest motion of these models by more than the share `RESERVE`.
"""

import math
from dataclasses import dataclass

from device.rig import ActuatorParameters, Rig
from device.rig.parameters import LargeSignalParameters, vary

APPROACH_S = 2.0  # time constant with which a coil approaches its temperature limit
LIGHTEST_FRAME_KG = 0.57  # a free board: it raises the resonance of a 0.25 kg mass by a fifth
RESERVE = 0.091  # reserved share of excursion and current limit for actuators between models
_SPACING = 0.24  # logarithm of the ratio of neighbouring resonance frequencies, times Q
_MODELS_MAX = 24
_STRONGER = 0.75
"""Share of the largest rise of Bl that all models have; it minimises the reserve. A large Bl gives
more excursion outside a resonance, a small Bl gives more at the resonance."""


@dataclass(frozen=True)
class Limits:
    """Limits of a rig; None means no limit.

    excursion_m: in either direction. current_a: peak. level: peak of the vibration, full scale 1.0.
    deviation: largest relative error of moving mass, Bl, and f0 (caused by the spring), 0 to 0.5.
    lightest_frame_kg: smallest mass of a free frame; inf for a fixed frame.
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

    The level is full scale, or the level at which the amplifier clips if that is lower. The coil's
    temperature limit is 120 °C if the rig has [thermal]. Even if the rig describes a seat, the
    frame counts as free, with the smaller of `LIGHTEST_FRAME_KG` and the seat's mass.
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
    """Return the actuator as identified, then the models that bound all possible actuators."""
    d = limits.deviation
    lightest = 1.0 - d
    if math.isfinite(limits.lightest_frame_kg):
        on_frame = limits.lightest_frame_kg / p.moving_mass_kg
        lightest *= on_frame / (lightest + on_frame)
    softest, stiffest = (1.0 - d) ** 2, (1.0 + d) ** 2
    # A large excursion stiffens the spring: over a sine, the effective x^2 is 3/4 of the peak's.
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
    """Counts since the start, and present values, of the protection.

    limited_blocks: blocks in which the gain was below 1. infeasible_blocks: blocks in which no gain
    could keep every limit; the gain became 0. replaced_samples: samples that counted as 0, because
    they were NaN or beyond ±1e6. gain, least_gain: smallest of all channels, now and since the
    start; 0 to 1. limited_by: cause of a gain below 1: "excursion, current or level",
    "temperature", "outside" (such as an exposure cap), or "". excursion_m: amplitude of a free
    oscillation with the present energy of the identified model. coil_c, resistance_ohm: temperature
    in °C and resistance of the warmest coil; None without a thermal model. latency_s: delay by the
    protection.
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

"""The few linear models that bound the excursion of every actuator that a rig may have.

The true actuator may differ from the rig file in the stiffness of its spring, in its moving mass
and in Bl, and its frame may move. A frame of mass M that nothing holds makes the moving mass m
behave like m M / (m + M), and a seat lies between that and solid ground. So mass and stiffness
fill a rectangle. Two of its sides bound it: softest spring from the heaviest to the lightest mass,
then lightest mass up to the stiffest spring. At each resonance these are the models with the
broadest response. Linear programming over all drives shows that no actuator of the rectangle, with
any Bl, exceeds the models on these sides by more than `RESERVE`.
"""

import math

from device.drive.protection.limits import Limits
from device.rig import ActuatorParameters
from device.rig.parameters import vary

RESERVE = 0.091
"""Share of the excursion that is reserved for actuators between the models, and for lower Bl."""

_SPACING = 0.24
"""Distance of two models, as the logarithm of the ratio of their resonances times Q."""
_MODELS_MAX = 24
_STRONGER = 0.75
"""Share of the possible rise of Bl that all models have. The largest Bl moves most outside of a
resonance, the smallest at it: between both, the reserve is smallest."""


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
    steps = math.ceil(span * p.q_total(source_impedance_ohm) / _SPACING)
    steps = min(max(1, steps), _MODELS_MAX)
    models = [p]
    for step in range(steps + 1):
        ratio = lowest * math.exp(span * step / steps)
        mass = max(lightest, softest / ratio**2)
        models.append(vary(p, mass, mass * ratio**2, 1.0 + _STRONGER * d))
    return models

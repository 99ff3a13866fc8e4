"""Rigs that an identified rig may truly be: f0 off by a share, since sitters shift it, or by swing.

Pure functions; any thread may call them.
"""

import math
from dataclasses import replace

from device.rig import ActuatorParameters


def detune(p: ActuatorParameters, share: float) -> ActuatorParameters:
    """The actuator with f0 (1 + share) by another stiffness; mass and friction as they are.

    share: above -1; -0.1 is 10 % lower.
    """
    factor = 1.0 + share
    return replace(p, resonance_hz=p.resonance_hz * factor, q_mechanical=p.q_mechanical * factor)


def stiffen(
    p: ActuatorParameters, stiffness_rise: float, force_factor_loss: float
) -> ActuatorParameters:
    """The linear actuator that swings as a non-linear one does at Xmax (describing function).

    stiffness_rise, force_factor_loss: shares by which stiffness is larger and Bl smaller there than
    at rest, both going with x^2. Over a sine, x^2 counts 3/4 of its peak for the spring's force and
    1/4 for what damps with the velocity.
    """
    factor = math.sqrt(1.0 + 0.75 * stiffness_rise)
    return replace(
        p,
        resonance_hz=p.resonance_hz * factor,
        q_mechanical=p.q_mechanical * factor,
        force_factor_n_per_a=p.force_factor_n_per_a * (1.0 - 0.25 * force_factor_loss),
    )

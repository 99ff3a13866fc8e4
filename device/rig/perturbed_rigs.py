"""Actuators that an identified one may really be: a sitter or a large excursion shifts f0.

Pure functions; any thread may call them.
"""

import math
from dataclasses import replace

from device.rig.parameters import ActuatorParameters


def detune(p: ActuatorParameters, share: float) -> ActuatorParameters:
    """Return the actuator with its f0 changed by a share (-0.1: 10 % lower) through stiffness."""
    factor = 1.0 + share
    return replace(p, resonance_hz=p.resonance_hz * factor, q_mechanical=p.q_mechanical * factor)


def stiffen(
    p: ActuatorParameters, stiffness_rise: float, force_factor_loss: float
) -> ActuatorParameters:
    """Return the linear actuator that behaves as a non-linear one at Xmax (describing function).

    The arguments are the shares by which stiffness is larger and Bl smaller there, both growing
    with x^2. Over a sine, x^2 counts 3/4 of its peak for the spring and 1/4 for the damping.
    """
    factor = math.sqrt(1.0 + 0.75 * stiffness_rise)
    return replace(
        p,
        resonance_hz=p.resonance_hz * factor,
        q_mechanical=p.q_mechanical * factor,
        force_factor_n_per_a=p.force_factor_n_per_a * (1.0 - 0.25 * force_factor_loss),
    )

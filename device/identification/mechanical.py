"""f0 and Qms from the mode under voltage drive, where only the acceleration could be measured.

The mode's poles solve (s^2 + s w0 / Qms + w0^2) (R + s L) + s Bl^2 / m = 0. With R, L, Bl and m as
the rig has them, that is one complex equation for w0^2 and w0 / Qms, both real.
"""

import math
from dataclasses import dataclass

import numpy as np

from device.identification.acceleration import (
    F0_BY_LEVEL,
    Q_BY_LEVEL,
    WIDEST_F0,
    WIDEST_Q,
    Mode,
    bent_square,
)
from device.identification.output_error import Estimate, require
from device.identification.recording import IdentificationError
from device.rig.rig import Rig
from device.units import FloatArray

_STEP = 1e-5


@dataclass(frozen=True)
class Mechanical:
    """f0_hz and q_mechanical with the coil open; their intervals take the rest of the rig as it
    is, so they are right as far as that is.
    """

    f0_hz: Estimate
    q_mechanical: Estimate


def mechanical(mode: Mode, rig: Rig) -> Mechanical:
    """What the mode under the rig's drive says of the mechanics.

    voltage: taken at the coil's terminals, so without the source's impedance.

    Raises
    ------
    IdentificationError
        The rig's Bl, R, L and m contradict the mode, or nothing follows from it.
    """
    if mode.drive == "current":
        return Mechanical(mode.f0_hz, mode.q)
    centre = mode.fit.logs[1:3]
    logs = _solved(centre, rig)
    columns = [
        (_solved(centre + shift, rig) - _solved(centre - shift, rig)) / (2.0 * _STEP)
        for shift in _STEP * np.eye(2)
    ]
    slopes = np.column_stack(columns)
    covariance = slopes @ mode.fit.covariance[1:3, 1:3] @ slopes.T
    reach = 1.96 * np.sqrt(np.diag(covariance))
    f0, q = (
        Estimate(math.exp(log), math.exp(log - r), math.exp(log + r))
        for log, r in zip(logs, np.minimum(reach, 50.0), strict=True)
    )
    share = bent_square(mode.level_of_x_max, mode.on_seat)
    require("f0_hz", f0, WIDEST_F0, "measure the current as well")
    require("q_mechanical", q, 2.0 * WIDEST_Q, "measure the current as well")
    # Qms is what is left of Q when the electrical damping is taken away: so is the level's share.
    widened = Q_BY_LEVEL * share * max(1.0, float(np.abs(slopes[1]).max()))
    return Mechanical(f0.lowered(F0_BY_LEVEL * share), q.lowered(widened))


def _solved(logs: FloatArray, rig: Rig) -> FloatArray:
    """log f0 and Qms for those of the mode."""
    a = rig.actuator
    w, q = math.tau * math.exp(logs[0]), math.exp(logs[1])
    real = -w / (2.0 * q)
    pole = complex(real, math.sqrt(max(w**2 - real**2, 0.0)))
    if pole.imag <= 0.0:
        raise IdentificationError(
            f"q={q:.3g} of the mode must be above 0.5: it does not ring, so f0 and Qms do not "
            "follow; measure the current as well"
        )
    motional = a.force_factor_n_per_a**2 / a.moving_mass_kg
    whole = -(pole**2) - motional * pole / (a.resistance_ohm + pole * a.inductance_h)
    rate = whole.imag / pole.imag
    square = whole.real - rate * pole.real
    if rate <= 0.0 or square <= 0.0:
        raise IdentificationError(
            f"the mode, Q {q:.3g}, is damped less than rig {rig.name!r} damps it electrically: "
            "force_factor_n_per_a, resistance_ohm, inductance_h or moving_mass_kg is wrong there; "
            "correct the rig, or measure the current as well"
        )
    return np.log([math.sqrt(square) / math.tau, math.sqrt(square) / rate])

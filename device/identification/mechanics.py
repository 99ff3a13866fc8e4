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
from device.identification.impedance import MOTIONAL, Impedance
from device.identification.output_error import Estimate, product, require
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


WIDEST_MASS, WIDEST_BL = 0.2, 0.2
_SENSITIVITY = {0: 1.0}


@dataclass(frozen=True)
class ForceFactor:
    """Bl, N/A, and the moving mass, kg, that it goes with."""

    force_factor_n_per_a: Estimate
    moving_mass_kg: Estimate


def by_known_mass(impedance: Impedance, mass: Estimate) -> ForceFactor:
    """Bl for a moving mass that was weighed, with its interval; kg.

    Raises
    ------
    IdentificationError
        Bl is not identified.
    """
    share = mass.relative / 1.96
    half = {index: 0.5 * power for index, power in MOTIONAL.items()}
    alone = product([(impedance.fit, half)], math.sqrt(math.tau * mass.value))
    spread = math.hypot(math.log(alone.high / alone.value), 0.5 * 1.96 * share)
    force_factor = _around(alone.value, spread)
    require("force_factor_n_per_a", force_factor, WIDEST_BL, "weigh the mass again")
    return ForceFactor(force_factor, mass)


def by_acceleration(impedance: Impedance, mode: Mode) -> ForceFactor:
    """Bl and m from Bl^2 / m of the impedance and Bl / m of the acceleration for the current.

    Raises
    ------
    IdentificationError
        The mode was measured against voltage or on a seat, or the values are not identified.
    """
    if mode.drive != "current":
        raise IdentificationError(
            f"drive={mode.drive!r} of the mode must be 'current': against voltage the sensitivity "
            "has the coil's resistance in it; fit the acceleration for the current"
        )
    if impedance.on_seat or mode.on_seat:
        raise IdentificationError(
            "Bl and the moving mass are not identified on a seat that gives way: the coil feels "
            "the frame move, the accelerometer does not; put the actuator on solid ground for them"
        )
    minus = {index: -power for index, power in _SENSITIVITY.items()}
    twice = {index: -2.0 * power for index, power in _SENSITIVITY.items()}
    force_factor = product([(impedance.fit, MOTIONAL), (mode.fit, minus)], math.tau)
    mass = product([(impedance.fit, MOTIONAL), (mode.fit, twice)], math.tau)
    advice = "fasten the accelerometer to what moves and sweep again"
    require("force_factor_n_per_a", force_factor, WIDEST_BL, advice)
    require("moving_mass_kg", mass, WIDEST_MASS, advice)
    return ForceFactor(force_factor, mass)


def _around(value: float, spread: float) -> Estimate:
    return Estimate(value, value * math.exp(-spread), value * math.exp(spread))

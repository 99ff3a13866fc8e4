"""Moving mass, Bl, f0 and Qms, from several measurements or with what the rig's file states.

Under voltage drive the mode's poles solve (s^2 + s w0 / Qms + w0^2) (R + s L) + s Bl^2 / m = 0.
With R, L, Bl and m of the rig, this is one complex equation for w0^2 and w0 / Qms, both real.

The impedance alone gives Bl^2 / m only (Thiele, Small). A known mass or Bl / m from an
accelerometer gives the rest.
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
    excursion_square,
)
from device.identification.impedance import MOTIONAL, Impedance
from device.identification.output_error import Estimate, multiply_powers, require
from device.identification.recording import IdentificationError
from device.rig.rig import Rig
from device.units import FloatArray

_STEP = 1e-5


@dataclass(frozen=True)
class Mechanical:
    """f0 and Qms with the coil open; the intervals assume that the rest of the rig is exact."""

    f0_hz: Estimate
    q_mechanical: Estimate


def solve_mechanics(mode: Mode, rig: Rig) -> Mechanical:
    """Return f0 and Qms that explain a mode; voltage is that at the coil's terminals.

    Raises
    ------
    IdentificationError
        The rig's Bl, R, L and m contradict the mode, or the mode does not ring.
    """
    if mode.drive == "current":
        return Mechanical(mode.f0_hz, mode.q)
    centre = mode.fit.logs[1:3]
    logs = _solve_logs(centre, rig)
    columns = [
        (_solve_logs(centre + shift, rig) - _solve_logs(centre - shift, rig)) / (2.0 * _STEP)
        for shift in _STEP * np.eye(2)
    ]
    slopes = np.column_stack(columns)
    covariance = slopes @ mode.fit.covariance[1:3, 1:3] @ slopes.T
    reach = 1.96 * np.sqrt(np.diag(covariance))
    f0, q = (
        Estimate(math.exp(log), math.exp(log - r), math.exp(log + r))
        for log, r in zip(logs, np.minimum(reach, 50.0), strict=True)
    )
    share = excursion_square(mode.level_of_x_max, mode.on_seat)
    require("f0_hz", f0, WIDEST_F0, "measure the current as well")
    require("q_mechanical", q, 2.0 * WIDEST_Q, "measure the current as well")
    # Qms is Q without the electrical damping, so the effect of the level grows alike.
    extent = Q_BY_LEVEL * share * max(1.0, float(np.abs(slopes[1]).max()))
    return Mechanical(f0.extend_down(F0_BY_LEVEL * share), q.extend_down(extent))


def _solve_logs(logs: FloatArray, rig: Rig) -> FloatArray:
    """Return the logs of f0 and Qms for those of the mode."""
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
    """Return Bl for a moving mass, kg, that was weighed.

    Raises
    ------
    IdentificationError
        Bl is not identified.
    """
    share = mass.relative / 1.96
    half = {index: 0.5 * power for index, power in MOTIONAL.items()}
    alone = multiply_powers([(impedance.fit, half)], math.sqrt(math.tau * mass.value))
    spread = math.hypot(math.log(alone.high / alone.value), 0.5 * 1.96 * share)
    force_factor = _around(alone.value, spread)
    require("force_factor_n_per_a", force_factor, WIDEST_BL, "weigh the mass again")
    return ForceFactor(force_factor, mass)


def by_acceleration(impedance: Impedance, mode: Mode) -> ForceFactor:
    """Return Bl and m from the impedance (Bl^2 / m) and acceleration for current (Bl / m).

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
    force_factor = multiply_powers([(impedance.fit, MOTIONAL), (mode.fit, minus)], math.tau)
    mass = multiply_powers([(impedance.fit, MOTIONAL), (mode.fit, twice)], math.tau)
    advice = "fasten the accelerometer to what moves and sweep again"
    require("force_factor_n_per_a", force_factor, WIDEST_BL, advice)
    require("moving_mass_kg", mass, WIDEST_MASS, advice)
    return ForceFactor(force_factor, mass)


def _around(value: float, spread: float) -> Estimate:
    return Estimate(value, value * math.exp(-spread), value * math.exp(spread))

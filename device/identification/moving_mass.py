"""Moving mass and Bl: from a known mass, an added one, or the acceleration for the current.

The impedance alone knows Bl^2 / m only. Thiele, Small: a known mass added to the moving one lowers
f0, and says how large that one is; an accelerometer says Bl / m instead.
"""

import math
from dataclasses import dataclass

from device.identification.acceleration import Mode
from device.identification.impedance import MOTIONAL, Impedance
from device.identification.output_error import Estimate, product, require
from device.identification.recording import IdentificationError

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


def by_added_mass(bare: Impedance, loaded: Impedance, added_kg: float) -> ForceFactor:
    """Bl and m from f0 without and with a mass fastened to the moving one: (f0 / f1)^2 = 1 + a/m.

    Raises
    ------
    IdentificationError
        The mass is not above 0, f0 has not fallen, or the values are not identified.
    """
    if not (math.isfinite(added_kg) and added_kg > 0.0):
        raise IdentificationError(f"added_kg={added_kg!r} must be above 0; weigh it")
    ratio = product([(bare.fit, {2: 2.0}), (loaded.fit, {2: -2.0})])
    if ratio.low <= 1.0:
        raise IdentificationError(
            f"the moving mass is not identified: {added_kg:g} kg more did not lower f0 by more "
            "than its interval; fasten it to what moves, or take a heavier one"
        )
    mass = Estimate(
        added_kg / (ratio.value - 1.0), added_kg / (ratio.high - 1.0), added_kg / (ratio.low - 1.0)
    )
    require("moving_mass_kg", mass, WIDEST_MASS, "add about as much as moves")
    return by_known_mass(bare, mass)


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

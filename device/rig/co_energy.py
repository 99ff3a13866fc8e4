"""The actuator's energy functions, from which force, flux and inductance follow, and their table.

    W'(x, i) = Phi(x) i + L(x) i^2 / 2            V(x) = k x^2 / 2 + ...

W' is the magnetic co-energy (equation 9): the coil in the magnet's field, and the reluctance. Its
derivatives describe the whole transducer: force dW'/dx, flux linkage dW'/di, incremental inductance
d^2W'/di^2. V is the energy in spring and stops.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from device.rig.parameters import ActuatorParameters, LargeSignalParameters
from device.rig.shapes import Arctangent, Hardening, Line, Shape, Stops, Tanh
from device.units import FloatArray

_TABLE_REACH = 4.0
"""Tables reach to this multiple of Xmax or of the stops."""
_TABLE_ERROR = 1e-9
"""Largest error of a table, as a share of the function's largest value."""
_MOST_INTERVALS = 1 << 15


@dataclass(frozen=True)
class Energies:
    """Everything but masses that stores energy in an actuator, and the loss of its stops."""

    magnet: Shape  # Phi, Wb; Phi' = Bl, N/A
    inductance: Shape  # L, H, above 0
    spring: Shape  # V without the stops, J
    stops: Stops
    stop_loss_s_per_m: float  # damping per speed and force of a stop (Hunt and Crossley 1975)


def linear_energies(p: ActuatorParameters) -> Energies:
    """Return those of the linear actuator: Phi = Bl x, L constant, V = k x^2 / 2, no stops."""
    return Energies(
        Line(p.force_factor_n_per_a),
        Tanh(p.inductance_h, 0.0, p.x_max_m),
        Hardening(p.stiffness_n_per_m, 0.0),
        Stops(math.inf, 0.0),
        0.0,
    )


def energies(p: ActuatorParameters, large: LargeSignalParameters | None) -> Energies:
    """Return those of an actuator with its large-signal behaviour, or the linear ones.

    Bl falls as 1 / (1 + (x / reach)^2); k rises by its share times (x / Xmax)^2.
    """
    if large is None:
        return linear_energies(p)
    loss = large.force_factor_loss
    magnet: Shape = Line(p.force_factor_n_per_a)
    if loss > 0.0:
        magnet = Arctangent(p.force_factor_n_per_a, p.x_max_m * math.sqrt((1.0 - loss) / loss))
    spring = p.stiffness_n_per_m
    return Energies(
        magnet,
        Tanh(p.inductance_h, large.inductance_change, p.x_max_m),
        Hardening(spring, spring * large.stiffness_rise / p.x_max_m**2),
        Stops(large.stop_m, large.stop_n_per_m2),
        large.stop_loss_s_per_m,
    )


@dataclass(frozen=True)
class Table:
    """Phi', 1 / L, L' / 2 and the spring's force as cubics of the excursion, all from W' and V.

    rows: (intervals, 16), four coefficients of the share of the interval for each, lowest first.
    """

    lowest_m: float
    intervals_per_m: float
    rows: FloatArray


@lru_cache(maxsize=64)
def table_of(e: Energies, x_max_m: float) -> Table:
    """Return the table of an actuator's energies; the stops are not in it."""
    stop_m = e.stops.start if math.isfinite(e.stops.start) else 0.0
    reach_m = _TABLE_REACH * max(x_max_m, stop_m)
    intervals = 128
    while True:
        knots = np.linspace(-reach_m, reach_m, intervals + 1)
        middles = np.linspace(-reach_m, reach_m, 2 * intervals + 1)[1::2]
        step_m = 2.0 * reach_m / intervals
        values, slopes = _tabled(e, knots)
        rows = np.concatenate(
            [_cubics(v, s * step_m) for v, s in zip(values, slopes, strict=True)], axis=1
        )
        found = rows.reshape(-1, 4, 4) @ (0.5 ** np.arange(4))
        worst = max(
            np.abs(got - value).max() / max(np.abs(value).max(), 1e-300)
            for got, value in zip(found.T, _tabled(e, middles)[0], strict=True)
        )
        if worst <= _TABLE_ERROR or intervals >= _MOST_INTERVALS:
            return Table(-reach_m, intervals / (2.0 * reach_m), np.ascontiguousarray(rows))
        intervals *= 2


def _tabled(e: Energies, x: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the four functions at x and their slopes."""
    _, force_factor, force_factor_slope = e.magnet.jet(x)
    inductance, slope, curvature = e.inductance.jet(x)
    _, spring_n, spring_n_m = e.spring.jet(x)
    values = [force_factor, 1.0 / inductance, 0.5 * slope, spring_n]
    return values, [force_factor_slope, -slope / inductance**2, 0.5 * curvature, spring_n_m]


def _cubics(values: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return (intervals, 4): Hermite cubics of the share of an interval, slopes per interval."""
    rise, left, right = np.diff(values), slopes[:-1], slopes[1:]
    return np.column_stack(
        [values[:-1], left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise]
    )

"""The actuator's energy functions, and a table of force factor, inductance and spring force.

    W'(x, i) = Phi(x) i + L(x) i^2 / 2            V(x) = k x^2 / 2 + ...

W' is the magnetic co-energy (equation 9 of the paper): a term for the coil in the magnet's field,
and one for the reluctance. Its derivatives are the force dW'/dx, the flux linkage dW'/di, and the
incremental inductance d^2W'/di^2. V is the energy in the spring and the end stops.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from device.rig.parameters import ActuatorParameters, LargeSignalParameters
from device.units import FloatArray

_TABLE_REACH = 4.0  # a table spans ± this factor times the larger of Xmax and the stops' start
_TABLE_ERROR = 1e-9  # largest error of a table, relative to the function's largest value
_MOST_INTERVALS = 1 << 15

Jet = tuple[FloatArray, FloatArray, FloatArray]
Shape = Callable[[FloatArray], Jet]  # from the excursion x, m: f, f' and f'', each of x's shape


@dataclass(frozen=True)
class Line:
    """f = slope x."""

    slope: float

    def __call__(self, x: FloatArray) -> Jet:
        """Return f, f' and f''."""
        return self.slope * x, np.full_like(x, self.slope), np.zeros_like(x)


@dataclass(frozen=True)
class Hardening:
    """f = stiffness x^2 / 2 + rise x^4 / 4: energy of a spring; stiffness N/m, rise N/m^3."""

    stiffness: float
    rise: float

    def __call__(self, x: FloatArray) -> Jet:
        """Return f, f' and f''."""
        square = x * x
        risen = self.rise * square
        first = (self.stiffness + risen) * x
        return (0.5 * self.stiffness + 0.25 * risen) * square, first, self.stiffness + 3.0 * risen


@dataclass(frozen=True)
class Arctangent:
    """f = slope reach atan(x / reach): flux of a coil that leaves its magnetic gap, f' = Bl."""

    slope: float  # f' at rest
    reach: float  # m, above 0: excursion at which f' has halved

    def __call__(self, x: FloatArray) -> Jet:
        """Return f, f' and f''."""
        z = x / self.reach
        share = 1.0 / (1.0 + z * z)
        first = self.slope * share
        second = first * share * z * (-2.0 / self.reach)
        return self.slope * self.reach * np.arctan(z), first, second


@dataclass(frozen=True)
class Tanh:
    """f = level (1 - share tanh(x / reach)): inductance of a coil that leaves the iron."""

    level: float
    share: float  # 0 to below 1
    reach: float  # m, above 0

    def __call__(self, x: FloatArray) -> Jet:
        """Return f, f' and f''."""
        t = np.tanh(x / self.reach)
        depth = self.level * self.share
        first = (t * t - 1.0) * (depth / self.reach)
        return self.level - depth * t, first, first * t * (-2.0 / self.reach)


@dataclass(frozen=True)
class Stops:
    """f = (hardness / 3) indentation^3 beyond ±start: the energy in two end stops."""

    start: float  # m, above 0
    hardness: float  # N/m^2, 0 or more

    def __call__(self, x: FloatArray) -> Jet:
        """Return f, f' and f''."""
        depth = np.maximum(np.abs(x) - self.start, 0.0)
        pressed = self.hardness * depth
        force = pressed * depth
        return force * depth / 3.0, np.copysign(force, x), 2.0 * pressed


@dataclass(frozen=True)
class Energies:
    """All stored energy of an actuator except kinetic energy, and the loss of its end stops."""

    magnet: Shape  # Phi, Wb; Phi' = Bl, N/A
    inductance: Shape  # L, H, above 0
    spring: Shape  # V without the end stops, J
    stops: Stops
    stop_loss_s_per_m: float  # relative rise of a stop's force per m/s (Hunt-Crossley 1975)


def energies(p: ActuatorParameters, large: LargeSignalParameters | None) -> Energies:
    """Return the energies of an actuator; without `large`: Phi = Bl x, constant L, V = k x^2 / 2.

    Bl is proportional to 1 / (1 + (x / reach)^2), k to 1 + stiffness_rise (x / Xmax)^2.
    """
    magnet: Shape = Line(p.force_factor_n_per_a)
    k = p.stiffness_n_per_m
    if large is None:
        constant, spring = Tanh(p.inductance_h, 0.0, p.x_max_m), Hardening(k, 0.0)
        return Energies(magnet, constant, spring, Stops(math.inf, 0.0), 0.0)
    if (loss := large.force_factor_loss) > 0.0:
        magnet = Arctangent(p.force_factor_n_per_a, p.x_max_m * math.sqrt((1.0 - loss) / loss))
    inductance = Tanh(p.inductance_h, large.inductance_change, p.x_max_m)
    spring = Hardening(k, k * large.stiffness_rise / p.x_max_m**2)
    stops = Stops(large.stop_m, large.stop_n_per_m2)
    return Energies(magnet, inductance, spring, stops, large.stop_loss_s_per_m)


@dataclass(frozen=True)
class Table:
    """Phi', 1 / L, L' / 2 and the spring force as piecewise cubic polynomials of the excursion.

    rows: (intervals, 16): for each function the four coefficients, lowest power first, of a
    polynomial in the position within the interval, 0 to 1.
    """

    lowest_m: float
    intervals_per_m: float
    rows: FloatArray


@lru_cache(maxsize=64)
def table_of(e: Energies, x_max_m: float) -> Table:
    """Return the table of an actuator's energies, without the end stops."""
    stop_m = e.stops.start if math.isfinite(e.stops.start) else 0.0
    reach_m = _TABLE_REACH * max(x_max_m, stop_m)
    intervals = 128
    while True:
        knots = np.linspace(-reach_m, reach_m, intervals + 1)
        middles = np.linspace(-reach_m, reach_m, 2 * intervals + 1)[1::2]
        step_m = 2.0 * reach_m / intervals
        functions = zip(*_tabled(e, knots), strict=True)
        rows = np.concatenate([_cubics(v, s * step_m) for v, s in functions], axis=1)
        found = rows.reshape(-1, 4, 4) @ (0.5 ** np.arange(4))
        worst = max(
            np.abs(got - value).max() / max(np.abs(value).max(), 1e-300)
            for got, value in zip(found.T, _tabled(e, middles)[0], strict=True)
        )
        if worst <= _TABLE_ERROR or intervals >= _MOST_INTERVALS:
            return Table(-reach_m, intervals / (2.0 * reach_m), np.ascontiguousarray(rows))
        intervals *= 2


def _tabled(e: Energies, x: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the four functions of `Table` at x, and their derivatives."""
    _, force_factor, force_factor_slope = e.magnet(x)
    inductance, slope, curvature = e.inductance(x)
    _, spring_n, spring_n_m = e.spring(x)
    values = [force_factor, 1.0 / inductance, 0.5 * slope, spring_n]
    return values, [force_factor_slope, -slope / inductance**2, 0.5 * curvature, spring_n_m]


def _cubics(values: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return Hermite cubics, (intervals, 4). slopes: derivatives times the interval length."""
    rise, left, right = np.diff(values), slopes[:-1], slopes[1:]
    return np.column_stack(
        [values[:-1], left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise]
    )

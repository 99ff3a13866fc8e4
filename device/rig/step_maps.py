"""What the steps of the non-linear model need, computed once: exponentials, and tables of W' and V.

Over a step h the remainder g is taken as the parabola through the Lobatto points 0, h/2 and h. Then
d(c h) = P d(0) + sum W_j g_j exactly, with P = exp(A c h) and W_j the integral of exp(A (c h - t))
times E and the j-th Lagrange polynomial (an exponential integrator: Hochbruck and Ostermann,
Exponential integrators, Acta Numerica 2010). The compiled form takes the cubic through the middle
before as well. Between samples the linear solution S follows from the same exponential and the
straight line of the voltage.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from device.rig.co_energy import Energies, linear_energies
from device.rig.equations import Equations
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

_WIDEST_S = 1.0 / 3_000.0
"""Steps are at most about this long; between a middle and an end, then, 6 kHz."""
_SHORTEST_S = 0.5e-6
_MOST_SAMPLES = 256
_FORGOTTEN_S = 0.1
"""Errors are shares of the peak within about this time."""
_TABLE_REACH = 4.0
"""Tables reach to this multiple of Xmax or of the stops; beyond, a step does not converge."""
_TABLE_ERROR = 1e-9
"""Largest error of a table, as a share of the function's largest value."""
_MOST_INTERVALS = 1 << 15

# Coefficients of t^0, t^1 and t^2 / 2 for the values at t = 0, 1/2 and 1: the parabola.
_PARABOLA = np.array([[1.0, 0.0, 0.0], [-3.0, 4.0, -1.0], [4.0, -8.0, 4.0]])
# And of t (t - 1/2) (t - 1), by which a cubic through one more point differs.
_CUBIC = np.array([0.0, 0.5, -3.0, 6.0])


@dataclass(frozen=True)
class StepMap:
    """The exponentials of one length of step, at its middle and its end, first index 0 and 1."""

    width_s: float
    onward: FloatArray  # P, (2, states, states)
    weights: FloatArray  # W, (2, 3 points, states, components)
    cubic: FloatArray  # the integral for t (t - 1/2) (t - 1), (2, states, components)
    base: FloatArray  # S and the volts at 0 and h to S, (2, 3, 5)

    def packed(self) -> FloatArray:
        """Return all of it in one row, and the share of a peak that is forgotten in a step."""
        parts = (self.onward, self.weights, self.cubic, self.base)
        first = [self.width_s, min(1.0, self.width_s / _FORGOTTEN_S)]
        return np.concatenate([first, *(part.ravel() for part in parts)])


@dataclass(frozen=True)
class Grid:
    """The lengths of steps: the widest, in samples, and how often it is halved."""

    samplerate: float
    widest: int  # a power of two
    levels: int

    def basis(self) -> FloatArray:
        """Return (levels of a sample and more, 8, widest): at the samples of a step.

        Four functions for a cubic with values and rates at both ends; four for one through the
        ends, the middle and the middle before.
        """
        whole = self.widest.bit_length()
        basis = np.zeros((whole, 8, self.widest))
        for level in range(whole):
            width = self.widest >> level
            t = np.arange(1, width + 1) / width
            rise, cubic = t * t * (3.0 - 2.0 * t), t * (t - 0.5) * (t - 1.0)
            first = [1.0 - rise, rise, t * (1.0 - t) ** 2, -t * t * (1.0 - t)]
            parabola = [(1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)]
            basis[level, :, :width] = [*first, *parabola, cubic]
        return basis


def grid_of(samplerate: float) -> Grid:
    """Return the lengths of steps for a sample rate, Hz."""
    widest = min(2 ** max(0, round(math.log2(samplerate * _WIDEST_S))), _MOST_SAMPLES)
    whole = math.log2(widest / samplerate / _SHORTEST_S)
    return Grid(samplerate, widest, max(widest.bit_length(), 1 + math.ceil(whole)))


@lru_cache(maxsize=64)
def step_maps(
    p: ActuatorParameters, source_impedance_ohm: float, seat: SeatParameters | None, grid: Grid
) -> tuple[StepMap, ...]:
    """Return the maps of all levels, the widest first."""
    equations = Equations(p, linear_energies(p), source_impedance_ohm, seat)
    return tuple(
        _step_map(equations, grid.widest / grid.samplerate / 2**level)
        for level in range(grid.levels)
    )


def _step_map(equations: Equations, width_s: float) -> StepMap:
    n, components = equations.entry.shape
    scale = equations.scale
    rate = scale[:, None] * equations.rate / scale
    entry = scale[:, None] * equations.entry
    onward, weights, cubic, base = [], [], [], []
    for share in (0.5, 1.0):
        until_s = share * width_s
        # One exponential gives the integrals for g = 1, t, t^2 / 2, t^3 / 6 (Van Loan 1978).
        whole = np.zeros((n + 4 * components,) * 2)
        whole[:n, :n] = rate * until_s
        whole[:n, n : n + components] = entry * until_s
        whole[n:-components, n + components :] = np.eye(3 * components)
        exponential = scipy.linalg.expm(whole)
        onward.append(exponential[:n, :n] * scale / scale[:, None])
        moments = exponential[:n, n:].reshape(n, 4, components) / scale[:, None, None]
        moments *= share ** np.arange(4)[:, None]
        weights.append(np.einsum("kj,nkc->jnc", _PARABOLA, moments[:, :3]))
        cubic.append(np.einsum("k,nkc->nc", _CUBIC, moments))
        # A voltage acts on the flux, as the second component does, in the three states of S.
        base.append(_base_map(equations, until_s, share))
    return StepMap(width_s, np.array(onward), np.array(weights), np.array(cubic), np.array(base))


def _base_map(equations: Equations, until_s: float, share: float) -> FloatArray:
    scale = equations.scale[:3]
    whole = np.zeros((5, 5))
    whole[:3, :3] = scale[:, None] * equations.rate[:3, :3] / scale * until_s
    whole[2, 3] = scale[2] * until_s
    whole[3, 4] = 1.0
    exponential = scipy.linalg.expm(whole)
    onward = exponential[:3, :3] * scale / scale[:, None]
    level, slope = exponential[:3, 3] / scale, share * exponential[:3, 4] / scale
    return np.column_stack([onward, level - slope, slope])


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
        knots, between = (
            np.linspace(-reach_m, reach_m, n) for n in (intervals + 1, 2 * intervals + 1)
        )
        step_m = 2.0 * reach_m / intervals
        rows = np.concatenate(
            [_cubics(v, s * step_m) for v, s in zip(*_tabled(e, knots), strict=True)], axis=1
        )
        middles = rows.reshape(-1, 4, 4) @ (0.5 ** np.arange(4))
        expected = _tabled(e, between[1::2])[0]
        worst = max(
            np.abs(got - value).max() / max(np.abs(value).max(), 1e-300)
            for got, value in zip(middles.T, expected, strict=True)
        )
        if worst <= _TABLE_ERROR or intervals >= _MOST_INTERVALS:
            return Table(-reach_m, intervals / (2.0 * reach_m), np.ascontiguousarray(rows))
        intervals *= 2


def _tabled(e: Energies, x: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the four functions at x and their slopes."""
    _, force_factor, force_factor_slope = e.co_energy.magnet.jet(x)
    inductance, slope, curvature = e.co_energy.inductance.jet(x)
    springs, stops = e.potential.jet(x), e.stops.jet(x)
    values = [force_factor, 1.0 / inductance, 0.5 * slope, springs[1] - stops[1]]
    slopes = [
        force_factor_slope, -slope / inductance**2, 0.5 * curvature, springs[2] - stops[2]
    ]  # fmt: skip
    full = [np.broadcast_to(v, x.shape).astype(np.float64) for v in (*values, *slopes)]
    return full[:4], full[4:]


def _cubics(values: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return (intervals, 4): Hermite cubics of the share of an interval, slopes per interval."""
    rise, left, right = np.diff(values), slopes[:-1], slopes[1:]
    return np.column_stack(
        [values[:-1], left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise]
    )

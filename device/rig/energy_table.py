"""The derivatives of W' and V as cubics of the excursion: what a step asks for, at one place."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from device.rig.co_energy import Energies
from device.units import FloatArray

_TABLE_REACH = 4.0
"""Tables reach to this multiple of Xmax or of the stops."""
_TABLE_ERROR = 1e-9
"""Largest error of a table, as a share of the function's largest value."""
_MOST_INTERVALS = 1 << 15


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

"""Fourth-order Hermite-Simpson collocation over a whole block of steps at once.

Between two nodes the solution is a cubic that satisfies the equations at both ends and in the
middle (Lobatto IIIA, three stages; Hairer and Wanner, Solving ODEs II, IV.5):

    d_m = (d_n + d_n+1) / 2 + h / 8 (f_n - f_n+1)
    d_n+1 = d_n + h / 6 (f_n + 4 f_m + f_n+1)

Newton's method changes all nodes of the block together. With the analytic Jacobian J, a change
e_n of d_n changes the residual by R e_n, and e_n+1 of d_n+1 by -Q e_n+1. Therefore

    e_n+1 = Q^-1 R e_n + Q^-1 left_n,    Q, R = I ∓ h/6 J_n,n+1 ∓ h/3 J_m + h^2/12 J_m J_n,n+1

which is one solution with a lower triangular band. If J is the linear part, Q and R are constant.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from device.rig.equations import EXCURSION, FLUX, Equations, Evaluation, Remainder
from device.rig.small_matrices import Factors, SmallMatrix, add_to_identity, multiply
from device.units import FloatArray

MAX_ITERATIONS = 12
CONVERGED = 1e-9
"""Largest predicted next change of Newton's method, as a share of the block's largest values."""
_FREEZE = 0.05
"""Below this change the Jacobian is reused: convergence is then fast enough."""


@dataclass(frozen=True)
class Base:
    """The linear solution on solid ground at the nodes or at the middles, (points,) each."""

    excursion_m: FloatArray
    speed_m_s: FloatArray  # of the excursion
    flux_wb: FloatArray
    acceleration_m_s2: FloatArray  # used with a seat only


Bases = tuple[Base, Base]
"""At the nodes, (nodes,), and at the middles, (nodes - 1,)."""


@dataclass(frozen=True)
class Linear:
    """d and its rate at the nodes, (states, nodes), and at the middles, (states, nodes - 1)."""

    nodes: FloatArray
    node_rates: FloatArray
    middles: FloatArray
    middle_rates: FloatArray


@dataclass(frozen=True)
class Path(Linear):
    """The result of Newton's method with the total current at the same points."""

    node_currents_a: FloatArray
    middle_currents_a: FloatArray
    iterations: int
    converged: bool  # then everything is finite


class Collocation:
    """Solves the equations on nodes that are step_s apart. One thread uses an object."""

    def __init__(self, equations: Equations, step_s: float) -> None:
        self.equations = equations
        self.step_s = step_s
        self._linear = _Newton(equations.states, equations.matrix, step_s)
        self._recurrence = _Recurrence(equations.states)
        self._linear_recurrence = _Recurrence(equations.states)

    def linear_path(
        self, base: Bases, start: FloatArray, g: tuple[Remainder, Remainder] | None = None
    ) -> Linear:
        """Solve d' = A d + E g for a known g, or 0, from d at the first node, (states,)."""
        equations, h, size = self.equations, self.step_s, self.equations.states
        nodes = len(base[0].excursion_m)
        d = np.zeros((size, nodes))
        forced = np.zeros((size, nodes))
        between = np.zeros((size, nodes - 1))
        d[:, 0] = start
        driven = g is not None or equations.seat is not None
        if driven:
            g_n, g_m = g if g is not None else (None, None)
            equations.add_remainder(forced, g_n, base[0].acceleration_m_s2)
            equations.add_remainder(between, g_m, base[1].acceleration_m_s2)
        if driven or np.any(start):
            left = (h / 6.0) * (forced[:, :-1] + 4.0 * between + forced[:, 1:])
            left += (h * h / 12.0) * equations.linear_rate(forced[:, :-1] - forced[:, 1:])
            right = self._linear.solve(left)
            right[:, 0] += self._linear.onward @ start
            self._linear_recurrence.hold(self._linear.onward_entries, nodes - 1)
            d[:, 1:] = self._linear_recurrence.run(right)
        rates = equations.linear_rate(d) + forced
        middles = _middles(d, rates, h)
        return Linear(d, rates, middles, equations.linear_rate(middles) + between)

    def remainder(self, base: Bases, path: "Linear") -> tuple[Remainder, Remainder]:
        """Return g of S + d at the nodes and at the middles."""
        return self._at(base[0], path.nodes)[0], self._at(base[1], path.middles)[0]

    def newton_path(self, base: Bases, guess: FloatArray) -> Path:
        """Solve the full equations from a guess at the nodes, (states, nodes); its first is kept.

        If it does not converge, the path says so and its values are undefined.
        """
        with np.errstate(all="ignore"):
            return self._newton(base, guess.copy())

    def _newton(self, base: Bases, d: FloatArray) -> Path:
        equations, h = self.equations, self.step_s
        scales = self._scales(base[0], d)
        newton: _Newton | None = None
        keep, converged, last = False, False, 0.0
        iterations = 0
        while True:
            g, passed = self._at(base[0], d)
            rates = equations.linear_rate(d)
            equations.add_remainder(rates, g, base[0].acceleration_m_s2)
            middles = _middles(d, rates, h)
            g_m, passed_m = self._at(base[1], middles)
            middle_rates = equations.linear_rate(middles)
            equations.add_remainder(middle_rates, g_m, base[1].acceleration_m_s2)
            if converged or iterations == MAX_ITERATIONS:
                break
            if fresh := newton is None or not keep:
                jacobian = equations.jacobian(equations.slopes(passed))
                jacobian_m = equations.jacobian(equations.slopes(passed_m))
                newton = _Newton(equations.states, jacobian, h, jacobian_m)
            left = d[:, :-1] - d[:, 1:]
            left += (h / 6.0) * (rates[:, :-1] + 4.0 * middle_rates + rates[:, 1:])
            if fresh:
                self._recurrence.set(newton.onward_entries, left.shape[1])
            change = self._recurrence.run(newton.solve(left))
            d[:, 1:] += change
            iterations += 1
            size = float(np.max(np.abs(change).max(axis=1) / scales))
            if not size < 1e3:  # NaN as well
                break
            # The next change would be smaller by at least the same factor.
            converged = size * (min(size / last, 1.0) if last else 1.0) <= CONVERGED
            keep, last = size <= _FREEZE, size
        finite = bool(np.isfinite(d).all() and np.isfinite(middle_rates).all())
        done = converged and finite
        currents = g.current_a, g_m.current_a
        return Path(d, rates, middles, middle_rates, *currents, iterations, done)

    def _at(self, base: Base, d: FloatArray) -> tuple[Remainder, Evaluation]:
        y = base.excursion_m + d[EXCURSION]
        w = base.speed_m_s + self.equations.relative_speed(d)
        return self.equations.remainder(y, w, base.flux_wb + d[FLUX])

    def _scales(self, base: Base, d: FloatArray) -> FloatArray:
        """Return the scale of each state's change, (states,), never 0."""
        p = self.equations.actuator
        y = max(_peak(base.excursion_m), _peak(d[EXCURSION]), 1e-6 * p.x_max_m)
        flux = max(_peak(base.flux_wb), p.force_factor_n_per_a * y)
        speed = y * p.resonance_rad_s
        return np.array([y, speed, flux, y, speed])[: len(d)]


class _Newton:
    """Q and R of a block, factored: they turn the residual of each step into changes."""

    def __init__(
        self, size: int, jacobian: SmallMatrix, h: float, middles: SmallMatrix | None = None
    ) -> None:
        first, last = (
            {k: e[points] if isinstance(e, np.ndarray) else e for k, e in jacobian.items()}
            for points in (slice(None, -1), slice(1, None))
        )
        middles = middles or jacobian
        a, b, c = h / 6.0, h / 3.0, h * h / 12.0
        onward = add_to_identity(size, (a, first), (b, middles), (c, multiply(middles, first)))
        back = add_to_identity(size, (-a, last), (-b, middles), (c, multiply(middles, last)))
        self._size = size
        self._factors = Factors(size, back)
        columns = [
            self._factors.solve([onward.get((row, column)) for row in range(size)])
            for column in range(size)
        ]
        self.onward_entries: SmallMatrix = {
            (row, column): entry
            for column, entries in enumerate(columns)
            for row, entry in enumerate(entries)
            if entry is not None
        }

    @property
    def onward(self) -> FloatArray:
        """Q^-1 R, (states, states), if it is constant."""
        matrix = np.zeros((self._size, self._size))
        for place, entry in self.onward_entries.items():
            matrix[place] = entry
        return matrix

    def solve(self, left: FloatArray) -> FloatArray:
        """Return Q^-1 left, (states, steps)."""
        solved = self._factors.solve(list(left))
        result = np.zeros_like(left)
        for row, entry in enumerate(solved):
            if entry is not None:
                result[row] = entry
        return result


class _Recurrence:
    """e_n+1 = M_n e_n + right_n from 0, by forward substitution in a band.

    Memory is reused between calls: allocating a megabyte costs more than the arithmetic.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._steps = 0
        self._columns = np.zeros((0, size, 2 * size))

    def set(self, onward: SmallMatrix, steps: int) -> None:
        """Set M_n for all steps, each entry a number or (steps,); M_0 is not used."""
        if steps > len(self._columns):
            self._columns = np.zeros((steps, self._size, 2 * self._size))
        for (row, column), entry in onward.items():
            # A band column holds the diagonal, which is 1, then the rows of e_n and e_n+1.
            inner = entry[1:] if isinstance(entry, np.ndarray) else entry
            place = self._columns[: steps - 1, column, self._size + row - column]
            np.negative(inner, out=place)
        self._steps = steps

    def hold(self, onward: SmallMatrix, steps: int) -> None:
        """Set one M for all steps, once."""
        if steps > len(self._columns):
            self.set(onward, max(steps, 1024))

    def run(self, right: FloatArray) -> FloatArray:
        """Return all e but the first, (states, steps), for as many steps as set or fewer."""
        steps = right.shape[1]
        columns = self._columns[:steps].reshape(-1, 2 * self._size)
        solved, _ = dtbtrs(columns.T, right.T.reshape(-1, 1), uplo="L", diag="U", overwrite_b=1)
        return np.asarray(solved).reshape(steps, self._size).T


def _middles(d: FloatArray, rates: FloatArray, h: float) -> FloatArray:
    middles = d[:, :-1] + d[:, 1:]
    middles *= 0.5
    bend = rates[:, :-1] - rates[:, 1:]
    bend *= h / 8.0
    middles += bend
    return middles


def _peak(samples: FloatArray) -> float:
    return float(np.max(np.abs(samples), initial=0.0))

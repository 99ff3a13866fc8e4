"""The non-linear model: exponential steps over the linear part, fixed-point sweeps over the rest.

A step from one node to the next asks for g at its middle and its end (step_maps.py). It begins with
the parabola of the step before; each sweep evaluates g at both points and computes d there again,
with g as the cubic through these, the node and the middle before. Two sweeps suffice where g is
small against the linear part, and no derivative of g is needed. What that cubic has beyond a
parabola measures the step's error: where it is too large, or sweeps do not converge, the step is
halved, down to shares of a sample.

One compiled function does that (native/nonlinear_model.c); `ReadableModel` is the same by parabolas
and without means of speed: it is what to read first, what tests compare with, and what runs where
nothing could be compiled.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from device import blocks
from device.rig.equations import (
    EXCURSION,
    FLUX,
    FORCE,
    FRAME,
    FRAME_SPEED,
    PUSH,
    SPEED,
    VOLTS,
    Equations,
)
from device.rig.step_maps import Grid, StepMap, grid_of, step_maps, table_of
from device.units import FloatArray

STEP_TOLERANCE = 6e-4
"""Measured error of a step's acceleration and current, as a share of their peaks; excursion is then
right to 1e-4, of white noise as well."""
FLOOR = 0.01
"""Errors are shares of a peak, or of this share of Xmax where the peak is less."""
ROWS = 5
"""Excursion, velocity, current, acceleration, and the seat's acceleration."""

_FINE_S = 1.0 / 40_000.0
"""Corners of the voltage need no shorter steps, since the coil filters them; end stops may."""
_SAFETY = 0.1
"""Of the cubic that the last four points have beyond a parabola; it is off by half of that."""
_PATH = np.dtype(
    [
        ("d", "f8", 5), ("g", "f8", 3), ("base", "f8", 3), ("volts", "f8"), ("shown", "f8", 4),
        ("before", "f8", 6), ("middle", "f8", 4), ("slopes", "f8", 10), ("error", "f8", 5),
        ("level", "f8"), ("largest", "f8", 2), ("fresh", "f8"), ("peaks", "f8", 4),
        ("sweeps", "f8"), ("steps", "f8"),
    ]
)  # fmt: skip


class Path:
    """Where a model is: d, (5,), the linear solution and the volts at its last node, and more."""

    def __init__(self, numbers: FloatArray | None = None) -> None:
        self.numbers = np.zeros(_PATH.itemsize // 8) if numbers is None else numbers
        self.fields = self.numbers.view(_PATH)[0]
        if numbers is None:
            self.begin(self.d)

    @property
    def d(self) -> FloatArray:
        """The difference from the linear solution, (5,), as a view."""
        return np.asarray(self.fields["d"])

    @property
    def base(self) -> FloatArray:
        """Excursion, velocity and flux L i of the linear solution, (3,), as a view."""
        return np.asarray(self.fields["base"])

    def begin(self, d: FloatArray) -> None:
        """Go on from another difference at the same node, without a past."""
        self.d[:] = d
        self.fields["error"] = 0.0
        self.fields["fresh"] = 1.0

    def copy(self) -> "Path":
        """Return another that is at the same place."""
        return Path(self.numbers.copy())


class Solved(NamedTuple):
    """How far a model came, and each finished block's peaks and errors."""

    samples: int
    blocks: FloatArray  # (blocks, 4): peaks of excursion and acceleration, errors of both


@dataclass
class NonlinearModel:
    """One actuator's equations on one grid, compiled. One thread uses an object.

    Arrays: volts (frames,); moved (5, frames), first the linear solution, to which d is added in
    place. `mask` has a bit for each row that is wanted. start: the sample after the last node.
    """

    equations: Equations
    samplerate: float
    step_tolerance: float = STEP_TOLERANCE
    linear: bool = False  # leave out g, so that d is what another model left

    grid: Grid = field(init=False)

    def __post_init__(self) -> None:
        e, p = self.equations, self.equations.actuator
        self.grid = grid_of(self.samplerate)
        self.maps = step_maps(p, e.source_impedance_ohm, e.seat, self.grid)
        table = table_of(e.energies, p.x_max_m)
        seat = e.seat
        frame = (
            (seat.mass_kg, seat.stiffness_n_per_m, seat.damping_n_s_per_m) if seat else (1, 0, 0)
        )
        self.least_m = FLOOR * p.x_max_m
        self.least_m_s2 = self.least_m * p.resonance_rad_s**2
        stops = e.energies.stops
        self._numbers = np.array(
            [
                e.mass, e.damping, e.stiffness, e.force_factor, e.inductance,
                e.linear_resistance_ohm, e.resistance_ohm,
                stops.start, stops.hardness, e.energies.stop_loss_s_per_m,
                table.lowest_m, table.intervals_per_m, len(table.rows), *frame,
                self.least_m, self.least_m_s2, self.least_m_s2 * e.mass / e.force_factor,
                self.step_tolerance, _FINE_S, _SAFETY, self.linear,
                e.force_factor / e.inductance, 1.0 / e.mass,
                *_decay(e.linear_resistance_ohm / e.inductance, 1.0 / self.samplerate),
            ],
            dtype=np.float64,
        )  # fmt: skip
        packed = np.array([one.packed() for one in self.maps])
        self._arrays = (self._numbers, table.rows, packed, self.grid.basis())

    def set_resistance(self) -> None:
        """Take over the equations' present resistance."""
        self._numbers[6] = self.equations.resistance_ohm

    def solve(
        self,
        volts: FloatArray,
        moved: FloatArray,
        path: Path,
        start: int,
        blocks_of: tuple[int, int, int],
        mask: int,
    ) -> Solved:
        """Add d to the samples from start on, and move the path; stop where a step fails.

        blocks_of: the length of the first block, of each further one, and of all together.
        """
        first, each, frames = blocks_of
        if blocks.compiled is None:
            return ReadableModel(self).solve(volts, moved, path, start, frames, mask)
        found = np.zeros((2 + max(0, frames - first) // each, 4))
        done = blocks.compiled.nonlinear_motion(
            volts,
            moved,
            *self._arrays,
            path.numbers,
            found,
            start,
            start + frames,
            first,
            each,
            mask,
        )
        whole = 0 if done < first else 1 + (done - first) // each
        return Solved(done, found[:whole])

    def count_linear(
        self,
        volts: FloatArray,
        moved: FloatArray,
        path: Path,
        pair: FloatArray,
        start: int,
        blocks_of: tuple[int, int, int],
        tolerance: float,
        margin: float,
    ) -> FloatArray:
        """Return as `Solved.blocks` the first blocks for which the linear model suffices.

        pair, (2, 5): d of the linear model, and that with the Born term, its answer to its own
        remainder; both go on. margin times their difference estimates the error.
        """
        first, each, frames = blocks_of
        found = np.zeros((1 + (frames - first) // each, 4))
        if blocks.compiled is None or self.grid.widest < 2:
            return found[:0]
        self._numbers[19] = tolerance
        count = blocks.compiled.linear_suffices(
            volts, moved, *self._arrays, path.copy().numbers, found, pair,
            start, start + frames, first, each, margin,
        )  # fmt: skip
        self._numbers[19] = self.step_tolerance
        return found[:count]


def _decay(rate_per_s: float, step_s: float) -> tuple[float, float, float]:
    """Return what a step keeps of a decaying value, and makes of a straight line's two ends."""
    share = rate_per_s * step_s
    kept, all_of_it = np.exp(-share), -np.expm1(-share) / rate_per_s
    new = (1.0 - all_of_it / step_s) / rate_per_s if share > 1e-4 else step_s * (0.5 - share / 6.0)
    return float(kept), float(all_of_it - new), float(new)


class ReadableModel:
    """The same in NumPy: steps of a sample or less, each swept until it does not change.

    It knows no tables, but evaluates the closed forms of W' and V.
    """

    CONVERGED = 1e-12
    """Largest last change of g, as a share of what the linear part makes at Xmax."""
    SWEEPS = 60

    def __init__(self, model: NonlinearModel) -> None:
        self.model, self.equations = model, model.equations
        self._first = model.grid.widest.bit_length() - 1  # the level of one sample

    def solve(
        self, volts: FloatArray, moved: FloatArray, path: Path, start: int, frames: int, mask: int
    ) -> Solved:
        """As `NonlinearModel.solve`, of one block; the errors are 0, since none is measured."""
        n, e = self.equations.states, self.equations
        peaks = np.zeros(4)
        for sample in range(start, start + frames):
            base = np.array([*moved[:2, sample], e.inductance * moved[2, sample]])
            s, d = np.array(path.base), path.d[:n].copy()
            try:
                d = self._step(self._first, s, d, path.fields["volts"].item(), volts[sample], base)
            except ArithmeticError:
                return Solved(sample - start, np.zeros((0, 4)))
            path.d[:n], path.base[:], path.fields["volts"] = d, base, volts[sample]
            peaks[:2] = np.maximum(peaks[:2], self._put(moved[:, sample], base, d, mask))
        path.fields["fresh"] = 1.0
        return Solved(frames, peaks[None])

    def _step(
        self, level: int, s: FloatArray, d: FloatArray, v0: float, v1: float, s1: FloatArray | None
    ) -> FloatArray:
        """Return d after a step of this level along a straight line of the voltage."""
        if level >= len(self.model.maps):
            raise ArithmeticError("no step is short enough")
        one = self.model.maps[level]
        points = one.base @ np.array([*s, v0, v1])
        if s1 is not None:
            points[1] = s1
        after = None if one.width_s > 2.0 * _FINE_S else self._sweep(one, s, d, points)
        if after is not None:
            return after
        middle_v = 0.5 * (v0 + v1)
        d = self._step(level + 1, s, d, v0, middle_v, points[0])
        return self._step(level + 1, points[0], d, middle_v, v1, points[1])

    def _sweep(
        self, one: StepMap, s: FloatArray, d: FloatArray, points: FloatArray
    ) -> FloatArray | None:
        """Return d at the end of a step, or None where it does not converge."""
        at_points = np.array([d, d, d])
        whole = np.array([s, *points])
        before: FloatArray | None = None
        scale = self.equations.stiffness * self.equations.actuator.x_max_m
        for _ in range(self.SWEEPS):
            g = self._remainder(whole, at_points)
            at_points[1:] = one.onward @ d + np.einsum("pjnc,jc->pn", one.weights, g)
            if not np.isfinite(at_points).all():
                return None
            if before is not None and np.abs(g - before).max() <= self.CONVERGED * scale:
                return np.asarray(at_points[2])
            before = g
        return None

    def _remainder(self, s: FloatArray, d: FloatArray) -> FloatArray:
        """Return g at some points, (points, components)."""
        e = self.equations
        w = s[:, SPEED] + d[:, SPEED] - (d[:, FRAME_SPEED] if e.seat else 0.0)
        g = np.zeros((len(s), e.entry.shape[1]))
        if not self.model.linear:
            found = e.remainder(s[:, EXCURSION] + d[:, EXCURSION], w, s[:, FLUX] + d[:, FLUX])
            g[:, FORCE], g[:, VOLTS] = found.force_n, found.volts
        if e.seat:
            g[:, PUSH] = e.mass * (s @ e.rate[SPEED, :3])
        return g

    def _put(self, row: FloatArray, s: FloatArray, d: FloatArray, mask: int) -> FloatArray:
        """Write one sample's values, (5,); return the magnitudes of excursion and acceleration."""
        e = self.equations
        w = d[SPEED] - (d[FRAME_SPEED] if e.seat else 0.0)
        y, q = s[EXCURSION] + d[EXCURSION], s[FLUX] + d[FLUX]
        force, current = 0.0, q / e.inductance
        if not self.model.linear:
            found = e.remainder(np.array([y]), np.array([s[SPEED] + w]), np.array([q]))
            force, current = float(found.force_n[0]), float(found.current_a[0])
        pull = e.force_factor / e.inductance
        a = (force + pull * q - e.stiffness * y - e.damping * (s[SPEED] + w)) / e.mass
        values = [y, s[SPEED] + w, current, a, 0.0]
        if e.seat:
            frame = e.seat.stiffness_n_per_m * d[FRAME] + e.seat.damping_n_s_per_m * d[FRAME_SPEED]
            values[4] = -(e.mass * a + frame) / e.seat.mass_kg
        for index, value in enumerate(values):
            if mask >> index & 1:
                row[index] = value
        return np.abs([y, a])

"""The models of one actuator over one segment of signal: what each adds to the linear solution.

    LINEAR      nothing, but motion left by another model decays by the linear equations
    CORRECTED   the remainder of the linear solution, filtered once by the linear equations
                (the Born term)
    NONLINEAR   the full equations by collocation; at twice the node rate inside the end stops
    STEPPED     the full equations sample by sample, passive; for what NONLINEAR cannot solve

Each begins with the same excursion, speed and flux, so any model may follow any other.
"""

import enum
from functools import partial

import numpy as np

from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION
from device.rig.collocation import Base, Bases, Collocation, Linear, Path
from device.rig.equations import (
    EXCURSION,
    FLUX,
    FRAME,
    FRAME_SPEED,
    SPEED,
    Equations,
    Remainder,
)
from device.rig.node_grid import NodeGrid, interpolate_cubic, interpolate_quadratic
from device.rig.passive_step import PassiveStepper
from device.rig.segment import Correction, Segment, join_corrections
from device.units import FloatArray

_MAX_BEND = 0.02
"""Largest second difference of the current between samples, as a share of its peak. Beyond it,
nodes and middles would alias high frequencies into the vibration."""

_PIECE_NODES = 33
"""A segment that does not converge is solved again in pieces of this many nodes."""


class ModelLevel(enum.StrEnum):
    """The models, from the cheapest to the one that never fails."""

    LINEAR = "linear"
    CORRECTED = "linear and one correction"
    NONLINEAR = "non-linear"
    STEPPED = "step by step"


class ModelLevels:
    """All models of one actuator on one grid. One thread uses an object."""

    def __init__(self, equations: Equations, grid: NodeGrid) -> None:
        self.equations = equations
        self.spacing = grid.spacing
        self._step_s = 1.0 / grid.samplerate
        self._coarse = Collocation(equations, grid.spacing * self._step_s)
        self._fine = Collocation(equations, grid.spacing // 2 * self._step_s)
        self._stepper = PassiveStepper(equations, self._step_s)
        self.reset()

    def reset(self) -> None:
        """Set the counts to 0."""
        self.iterations = 0
        self.stepped_samples = 0

    def solve(
        self, level: ModelLevel, segment: Segment, start: FloatArray, under: FloatArray
    ) -> Correction:
        """Return one level's correction from d at the first node, (states,).

        CORRECTED uses the remainder of a path that begins at `under`.
        """
        if level is ModelLevel.LINEAR and self.equations.seat is None and not np.any(start):
            return self._zero_correction(segment)
        if level is ModelLevel.STEPPED:
            return self._solve_stepped(segment, start)
        bases = self.base_solutions(segment, self.spacing)
        linear = self.solve_linear(bases, under if level is ModelLevel.CORRECTED else start)
        if level is ModelLevel.LINEAR:
            return self.correct_by(bases, linear)
        if level is ModelLevel.CORRECTED:
            born, g = self.solve_born(bases, start, linear)
            return self.correct_by(bases, born, g, linear)
        return self.solve_nonlinear(segment, start, linear)

    def base_solutions(self, segment: Segment, spacing: int) -> Bases:
        """Return the linear solution at nodes and middles with that spacing."""
        y, w, i, a = (samples for name, samples in vars(segment).items() if name != "volts")
        flux = self._linear_flux(y, i)
        return (
            Base(*(samples[::spacing] for samples in (y, w, flux, a))),
            Base(*(samples[spacing // 2 :: spacing] for samples in (y, w, flux, a))),
        )

    def _linear_flux(self, y: FloatArray, i: FloatArray) -> FloatArray:
        p = self.equations.actuator
        return p.force_factor_n_per_a * y + p.inductance_h * i

    def _linear_current(self, y: FloatArray, flux: FloatArray) -> FloatArray:
        p = self.equations.actuator
        return (flux - p.force_factor_n_per_a * y) / p.inductance_h

    def solve_linear(self, bases: Bases, start: FloatArray) -> Linear:
        """Return d without a remainder."""
        return self._coarse.linear_path(bases, start)

    def _zero_correction(self, segment: Segment) -> Correction:
        end, frames = np.zeros(self.equations.states), len(segment.volts) - 1
        zeros = dict.fromkeys((*QUANTITIES, SEAT_ACCELERATION), lambda: np.zeros(frames))
        found = Correction(end, zeros, segment.displacement_m)
        found.is_zero = True
        return found

    def solve_born(
        self, bases: Bases, start: FloatArray, before: Linear
    ) -> tuple[Linear, tuple[Remainder, Remainder]]:
        """Return d under the remainder of another path, and that remainder."""
        g = self._coarse.remainder(bases, before)
        return self._coarse.linear_path(bases, start, g), g

    def correct_by(
        self,
        bases: Bases,
        path: Linear,
        g: tuple[Remainder, Remainder] | None = None,
        under: Linear | None = None,
    ) -> Correction:
        """Return the correction of a linear path; g is the remainder of the path `under`."""
        currents = []
        for k, (base, d) in enumerate(zip(bases, (path.nodes, path.middles), strict=True)):
            current = self._linear_current(d[EXCURSION], d[FLUX])
            if g is not None and under is not None:
                # The current of g's path beyond the linear one.
                other = (under.nodes, under.middles)[k]
                y, flux = base.excursion_m + other[EXCURSION], base.flux_wb + other[FLUX]
                current = current + g[k].current_a - self._linear_current(y, flux)
            currents.append(current)
        found = self._correction(path, bases, currents[0], currents[1], self.spacing)
        if under is not None:
            found.under_end = under.nodes[:, -1].copy()
        return found

    def solve_nonlinear(self, segment: Segment, start: FloatArray, guess: Linear) -> Correction:
        """Return d of the full equations; without convergence, in pieces or step by step."""
        low = self._filter_low_band(segment) if self._has_more_content(segment) else segment
        bases = self.base_solutions(low, self.spacing)
        nodes = guess.nodes.copy()
        nodes[:, 0] = start
        path = self._coarse.newton_path(bases, nodes)
        self.iterations += path.iterations
        if not path.converged:
            return self._solve_pieces(segment, start)
        found = self._correct_by_path(path, bases, self.spacing)
        if np.abs(found.excursions_m).max() <= self.equations.energies.stops.start:
            return found
        # Nodes and middles are the nodes of the finer grid.
        twice = np.empty((len(path.nodes), 2 * path.nodes.shape[1] - 1))
        twice[:, ::2], twice[:, 1::2] = path.nodes, path.middles
        return self._refine(low, twice) or self._solve_pieces(segment, start)

    def _solve_stepped(self, segment: Segment, start: FloatArray) -> Correction:
        state, size = start.copy(), self.equations.states
        y, w, i = segment.displacement_m, segment.velocity_m_s, segment.current_a
        flux = self._linear_flux(y, i)
        state[:3] += [y[0], w[0], flux[0]]
        self._stepper.state = [*state.tolist(), 0.0, 0.0][:5]
        whole = self._stepper.move(segment.volts[1:], float(segment.volts[0]))
        self.stepped_samples += whole.shape[1]
        speed = whole[SPEED] - whole[FRAME_SPEED]
        end = whole[:size, -1] - np.array([y[-1], w[-1], flux[-1], 0.0, 0.0])[:size]
        added = whole[6] - segment.acceleration_m_s2[1:]
        samples = {
            "displacement_m": whole[EXCURSION] - y[1:],
            "velocity_m_s": speed - w[1:],
            "current_a": whole[5] - i[1:],
            "acceleration_m_s2": added,
            SEAT_ACCELERATION: self._frame_acceleration(added, whole[FRAME], whole[FRAME_SPEED]),
        }
        given = {name: partial(samples.__getitem__, name) for name in samples}
        return Correction(end, given, whole[EXCURSION])

    def _has_more_content(self, segment: Segment) -> bool:
        i = segment.current_a[:: max(1, self.spacing // 8)]
        if len(i) < 3:
            return False
        bend = float(np.max(np.abs(i[2:] - 2.0 * i[1:-1] + i[:-2])))
        return bend > _MAX_BEND * float(np.max(np.abs(i)))

    def _filter_low_band(self, segment: Segment) -> Segment:
        """Return the segment without the content that nodes and middles would alias.

        The linear solution keeps all of it. A triangle has double zeros at the multiples of twice
        the node rate; a second difference compensates its droop. Ends are point-mirrored.
        """
        width = self.spacing // 2
        box = np.full(width, 1.0 / width)
        droop = (width * width - 1.0) / 12.0
        kernel = np.convolve(np.convolve(box, box), [-droop, 1.0 + 2.0 * droop, -droop])
        reach = len(kernel) // 2
        if len(segment.volts) <= reach:
            return segment
        smooth = [
            np.convolve(np.pad(samples, reach, "reflect", reflect_type="odd"), kernel, "valid")
            for name, samples in vars(segment).items()
            if name != "volts"
        ]
        return Segment(segment.volts, *smooth)

    def frame_share(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """Return the frame's acceleration due to that of the moving mass alone, (frames,)."""
        seat = self.equations.seat
        return acceleration_m_s2 * (-self.equations.mass / seat.mass_kg if seat else 0.0)

    def _frame_acceleration(
        self, added_m_s2: FloatArray, frame_m: FloatArray, frame_m_s: FloatArray
    ) -> FloatArray:
        """Return what to add to the linear solution's share."""
        seat = self.equations.seat
        if seat is None:
            return np.zeros_like(added_m_s2)
        force = seat.stiffness_n_per_m * frame_m + seat.damping_n_s_per_m * frame_m_s
        return np.asarray(self.frame_share(added_m_s2) - force / seat.mass_kg)

    def _refine(self, segment: Segment, guess: FloatArray) -> Correction | None:
        """Solve on the finer grid; None if it does not converge."""
        spacing = self.spacing // 2
        bases = self.base_solutions(segment, spacing)
        path = self._fine.newton_path(bases, guess)
        self.iterations += path.iterations
        return self._correct_by_path(path, bases, spacing) if path.converged else None

    def _solve_pieces(self, segment: Segment, start: FloatArray) -> Correction:
        pieces = []
        length, samples = (_PIECE_NODES - 1) * self.spacing, len(segment.volts) - 1
        for first in range(0, samples, length):
            piece = segment.part(first, min(first + length, samples))
            nodes = (len(piece.volts) - 1) // (self.spacing // 2) + 1
            guess = np.repeat(start[:, None], nodes, axis=1)
            found = self._refine(piece, guess) or self._solve_stepped(piece, start)
            pieces.append(found)
            start = found.end
        return join_corrections(pieces)

    def _correct_by_path(self, path: Path, bases: Bases, spacing: int) -> Correction:
        nodes, middles = (
            current - self._linear_current(base.excursion_m, base.flux_wb)
            for base, current in zip(
                bases, (path.node_currents_a, path.middle_currents_a), strict=True
            )
        )
        return self._correction(path, bases, nodes, middles, spacing)

    def _correction(
        self,
        path: Linear,
        bases: Bases,
        node_currents: FloatArray,
        middle_currents: FloatArray,
        spacing: int,
    ) -> Correction:
        step_s = spacing * self._step_s
        speed = self.equations.relative_speed

        def displacement() -> FloatArray:
            return interpolate_cubic(path.nodes[EXCURSION], speed(path.nodes), step_s, spacing)

        def velocity() -> FloatArray:
            return interpolate_cubic(speed(path.nodes), speed(path.node_rates), step_s, spacing)

        def acceleration() -> FloatArray:
            return interpolate_quadratic(path.node_rates[SPEED], path.middle_rates[SPEED], spacing)

        def frame_acceleration() -> FloatArray:
            if self.equations.seat is None:
                return np.zeros((path.nodes.shape[1] - 1) * spacing)
            frame = interpolate_cubic(path.nodes[FRAME], path.nodes[FRAME_SPEED], step_s, spacing)
            speeds, rates = path.nodes[FRAME_SPEED], path.node_rates[FRAME_SPEED]
            moving = interpolate_cubic(speeds, rates, step_s, spacing)
            return self._frame_acceleration(acceleration(), frame, moving)

        return Correction(
            path.nodes[:, -1].copy(),
            {
                "displacement_m": displacement,
                "velocity_m_s": velocity,
                "current_a": lambda: interpolate_quadratic(node_currents, middle_currents, spacing),
                "acceleration_m_s2": acceleration,
                SEAT_ACCELERATION: frame_acceleration,
            },
            bases[0].excursion_m + path.nodes[EXCURSION],
        )

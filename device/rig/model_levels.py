"""The models of one actuator, each of which adds a difference d to the exact linear solution.

    LINEAR      nothing, but motion left by another model decays by the linear equations
    NONLINEAR   the full equations by exponential steps (nonlinear_model.py)
    STEPPED     the full equations sample by sample, passive; for what NONLINEAR cannot solve

Each begins with the same excursion, speed and flux, so any model may follow any other.
"""

import enum
from dataclasses import dataclass

import numpy as np

from device import blocks
from device.rig.equations import EXCURSION, FLUX, FRAME, FRAME_SPEED, SPEED, Equations
from device.rig.nonlinear_model import NonlinearModel, Path
from device.rig.passive_step import PassiveStepper
from device.units import FloatArray


class ModelLevel(enum.StrEnum):
    """The models, from the cheapest to the one that never fails."""

    LINEAR = "linear"
    NONLINEAR = "non-linear"
    STEPPED = "step by step"


@dataclass(frozen=True)
class BlockReport:
    """How one block was computed."""

    frame: int  # number of the block's first frame since the start
    frames: int
    level: ModelLevel
    estimate: float  # measured error as a share of the peak; infinity where it was stepped
    excursion_peak_m: float


class ModelLevels:
    """All models of one actuator on one grid. One thread uses an object.

    Arrays are those of `NonlinearModel`. stepped_samples: how many were solved step by step.
    """

    def __init__(self, equations: Equations, samplerate: float, step_tolerance: float) -> None:
        self.equations = equations
        self.nonlinear = NonlinearModel(equations, samplerate, step_tolerance)
        self.linear = NonlinearModel(equations, samplerate, step_tolerance, linear=True)
        self.widest = self.nonlinear.grid.widest
        self._stepper = PassiveStepper(equations, 1.0 / samplerate)
        self.stepped_samples = 0

    def solve(
        self,
        level: ModelLevel,
        volts: FloatArray,
        moved: FloatArray,
        path: Path,
        start: int,
        blocks_of: tuple[int, int, int],
        mask: int,
    ) -> FloatArray:
        """Solve by one model, and by steps what it cannot; return `Solved.blocks` of all blocks.

        Where steps were needed, the block's errors are infinite, since nothing measures them.
        """
        first, each, frames = blocks_of
        lengths = [first, *[each] * ((frames - first) // each)]
        if level is ModelLevel.LINEAR and self.passes_linear(volts, moved, path, start + frames):
            return self._linear_peaks(moved, start, lengths)
        done, rows = 0, np.zeros((0, 4))
        if level is not ModelLevel.STEPPED:
            done, rows = self._model(level).solve(volts, moved, path, start, blocks_of, mask)
        found = list(rows)
        at, begun = start + done, start + sum(lengths[: len(rows)])
        for length in lengths[len(rows) :]:
            end = begun + length
            found.append(self._solve_block(level, volts, moved, path, (begun, at, end), mask))
            at = begun = end
        return np.array(found).reshape(-1, 4)

    def _model(self, level: ModelLevel) -> NonlinearModel:
        model = self.linear if level is ModelLevel.LINEAR else self.nonlinear
        model.set_resistance()
        return model

    def passes_linear(self, volts: FloatArray, moved: FloatArray, path: Path, stop: int) -> bool:
        """Return whether the linear solution itself is the answer; if so, go on to a sample."""
        if self.equations.seat is not None or np.any(path.d):
            return False
        self._keep_base(volts, moved, path, stop - 1)
        path.begin(path.d)
        return True

    def _linear_peaks(self, moved: FloatArray, start: int, lengths: list[int]) -> FloatArray:
        found = np.zeros((len(lengths), 4))
        for row, length in zip(found, lengths, strict=True):
            row[:2] = [blocks.peak(moved[k, start : start + length]) for k in (0, 3)]
            start += length
        return found

    def _keep_base(self, volts: FloatArray, moved: FloatArray, path: Path, sample: int) -> None:
        path.base[:] = moved[:3, sample]
        path.base[FLUX] *= self.equations.inductance
        path.fields["volts"] = volts[sample]

    def _solve_block(
        self,
        level: ModelLevel,
        volts: FloatArray,
        moved: FloatArray,
        path: Path,
        places: tuple[int, int, int],
        mask: int,
    ) -> FloatArray:
        """Finish a block that began at a place, is solved up to another, and ends at a third.

        Where a step did not converge, one of the widest is made sample by sample.
        """
        begun, at, end = places
        stuck = at > begun
        while at < end:
            if level is not ModelLevel.STEPPED and not stuck:
                rest = (end - at,) * 3
                done, rows = self._model(level).solve(volts, moved, path, at, rest, mask)
                at += done
                if len(rows):
                    return np.asarray(rows[0])
            until = end
            if level is not ModelLevel.STEPPED:
                until = min(at + self.widest - (at - begun) % self.widest, end)
            self._step(volts, moved, path, at, until, mask)
            at, stuck = until, False
        return self._peaks(path)

    def _step(
        self, volts: FloatArray, moved: FloatArray, path: Path, start: int, stop: int, mask: int
    ) -> None:
        """Make some samples step by step, and move the path there."""
        e, size = self.equations, self.equations.states
        state = np.zeros(5)
        state[:size] = path.d[:size]
        state[:3] += path.base
        magnet = e.energies.co_energy.magnet
        # The stepper's flux is that of coil and magnet.
        state[FLUX] += magnet.value(float(state[EXCURSION]))
        self._stepper.state = state.tolist()
        whole = self._stepper.move(volts[start:stop], float(path.fields["volts"]))
        self.stepped_samples += stop - start
        self._keep_base(volts, moved, path, stop - 1)
        speed = whole[SPEED] - whole[FRAME_SPEED]
        values = [whole[EXCURSION], speed, whole[5], whole[6]]
        if e.seat:
            force = e.seat.stiffness_n_per_m * whole[FRAME]
            force += e.seat.damping_n_s_per_m * whole[FRAME_SPEED] + e.mass * whole[6]
            values.append(-force / e.seat.mass_kg)
        for row, value in enumerate(values):
            if mask >> row & 1:
                moved[row, start:stop] = value
        last = whole[:5, -1]
        last[FLUX] -= magnet.value(float(last[EXCURSION]))
        last[:3] -= path.base
        path.begin(last)
        peaks = path.fields["peaks"]
        reached = [np.abs(whole[EXCURSION]).max(), np.abs(whole[6]).max(), np.inf, np.inf]
        peaks[:] = np.maximum(peaks, reached)

    def _peaks(self, path: Path) -> FloatArray:
        """Return the peaks and errors since the last report, and forget them."""
        row = np.array(path.fields["peaks"])
        path.fields["peaks"] = 0.0
        return row

"""An actuator that models only what a scene needs: each block gets the cheapest sufficient model.

The exact linear solution of the whole signal is always there, and the non-linear model adds to it
(model_levels.py). Its answer to its own remainder, the Born term, estimates the error of leaving
that out. The non-linear model begins with the best known state, and a change of model is
crossfaded.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from device import blocks
from device.errors import UsageError
from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION, LinearActuator, Motion
from device.rig.co_energy import energies
from device.rig.crossfade import crossfade
from device.rig.equations import FLUX, Equations
from device.rig.model_levels import BlockReport, ModelLevel, ModelLevels
from device.rig.nonlinear_model import ROWS, STEP_TOLERANCE, Path
from device.rig.parameters import check_tolerance
from device.rig.rig import Rig
from device.rig.thermal import Temperatures
from device.units import FloatArray, finite_or_zero

BLOCK_S = 0.1
FADE_S = 0.01
MARGIN = 2.0
"""The Born term times this estimates the error without it."""

_FADE_SHARE = 0.25
"""A crossfade may deviate by this share of the tolerance."""
_STEP_SHARE = 0.15
"""Steps of the non-linear model may be off by this share of the tolerance: of the roughest drives
some samples are off by six times what the steps' points say."""
_ALIKE = 0.7
"""A block with this share of the excursion of one that was not linear is not estimated,"""
_TRUSTED = 7
"""for this many blocks."""
_FLUX_SHARE = 0.05
"""A difference of flux decays within the linear model's first step, between whose points it is
interpolated: that errs by up to 4 % of its force, as measured."""
_SILENT = 1e-2
"""Share of the tolerance at the least peak, below which d becomes 0."""
_ABSURD_V = 1e6
_REPORTS = 4_096
_PART_BLOCKS = 4
_NAMES = (*QUANTITIES, SEAT_ACCELERATION)


@dataclass
class _Progress:
    """Where the models are: at the last node."""

    level: ModelLevel
    path: Path = field(default_factory=Path)
    pair: FloatArray = field(default_factory=lambda: np.zeros((2, 5)))  # linear, and with Born term
    samples: int = 0

    def copy(self) -> "_Progress":
        return _Progress(self.level, self.path.copy(), self.pair.copy(), self.samples)


class AdaptiveActuator:
    """One actuator with all its models; it keeps its state between blocks. One thread calls it.

    Between samples the voltage is a straight line, and it was 0 before the first. Samples after the
    last node are computed twice: for now by narrower steps, and for the state with the next node.
    So the state of a model does not depend on how the signal is split.

    tolerance: allowed error of excursion and acceleration as a share of a block's peak, above 0 and
    at most 1. level: use this model always, whatever its error. seat, temperature: the actuator is
    on the rig's seat instead of solid ground; the coil warms up. step_tolerance: what the steps of
    the non-linear model may be off by, None for what the tolerance asks for.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: float,
        tolerance: float = 1e-3,
        *,
        level: ModelLevel | None = None,
        seat: bool = False,
        temperature: bool = False,
        step_tolerance: float | None = None,
    ) -> None:
        check_tolerance(tolerance)
        for wanted, name in ((seat, "seat"), (temperature, "thermal")):
            if wanted and getattr(rig, name) is None:
                raise UsageError(f"rig {rig.name!r} describes no [{name}]; add it to its file")
        source = rig.amplifier.source_impedance_ohm
        if rig.large_signal is None and not (seat or temperature):
            level = level or ModelLevel.LINEAR  # there is no remainder
        self.rig, self.samplerate, self.tolerance, self.level = rig, samplerate, tolerance, level
        self._base = LinearActuator(rig.actuator, samplerate, source)
        large = energies(rig.actuator, rig.large_signal)
        self.equations = Equations(rig.actuator, large, source, rig.seat if seat else None)
        step_tolerance = step_tolerance or min(STEP_TOLERANCE, _STEP_SHARE * tolerance)
        self._levels = ModelLevels(self.equations, samplerate, step_tolerance)
        self.temperatures: Temperatures | None = None
        if temperature and rig.thermal:
            self.temperatures = Temperatures(rig.thermal)
        self._q = self._levels.widest
        self._block = self._q * max(1, round(BLOCK_S * samplerate / self._q))
        self._fade = self._q * max(1, round(FADE_S * samplerate / self._q))
        model = self._levels.nonlinear
        self._least_m, self._least_m_s2 = model.least_m, model.least_m_s2
        size, rate = _SILENT * tolerance * model.least_m, rig.actuator.resonance_rad_s
        per_m = rig.actuator.stiffness_n_per_m * rig.actuator.inductance_h
        per_m /= rig.actuator.force_factor_n_per_a
        self._silent = size * np.array([1.0, rate, per_m, 1.0, rate])
        self.reset()

    def reset(self) -> None:
        """Come to rest, cool down, and clear reports and counts."""
        self._base.reset()
        self._levels.stepped_samples = 0
        if self.temperatures:
            self.temperatures.reset()
        self.equations.resistance_ohm = self.equations.linear_resistance_ohm
        self.replaced_samples = 0  # volts that were not finite or above 1e6 and became 0
        self.reports: deque[BlockReport] = deque(maxlen=_REPORTS)
        self.frames_by_level = dict.fromkeys(ModelLevel, 0)
        self._at = _Progress(self.level or ModelLevel.LINEAR)
        self._beyond_m, self._trusted = math.inf, 0
        # Volts and linear solution after the last node.
        self._pending = np.empty(0), np.empty((ROWS, 0))

    @property
    def block_frames(self) -> int:
        """Frames for which a model is chosen, about 0.1 s."""
        return self._block

    @property
    def stepped_frames(self) -> int:
        """Frames so far that were solved step by step, whatever model was selected."""
        return self._levels.stepped_samples

    def move(self, volts: FloatArray, outputs: Sequence[str] = QUANTITIES) -> Motion:
        """Return the motion under the amplifier's next open-circuit volts, (frames,).

        It is always finite. Of the `outputs`, seat_acceleration_m_s2 needs a seat.
        """
        finite = np.ascontiguousarray(volts, dtype=np.float64)
        if not blocks.peak(finite) <= _ABSURD_V:  # NaN as well
            finite, replaced = finite_or_zero(finite, _ABSURD_V)
            self.replaced_samples += replaced
        moved = np.empty((ROWS, len(finite)))
        mask = sum(1 << row for row, name in enumerate(_NAMES) if name in outputs)
        if SEAT_ACCELERATION in outputs:
            mask |= 8  # it follows from the acceleration of the moving mass
        start, frames = 0, len(finite)
        while start < frames:
            # Parts that stay in the cache end at nodes.
            stop = min(start + _PART_BLOCKS * self._block - len(self._pending[0]), frames)
            self._base.move_into(finite, QUANTITIES, moved[: len(QUANTITIES)], start, stop)
            self._solve(finite, moved, start, stop, mask)
            start = stop
        nothing: FloatArray = np.empty(0)
        return Motion(
            *(row if name in outputs else nothing for name, row in zip(_NAMES, moved, strict=True))
        )

    def _solve(self, volts: FloatArray, moved: FloatArray, start: int, end: int, mask: int) -> None:
        """Add the models' answer to the linear solution, and keep what is after the last node."""
        known = len(self._pending[0])
        if known:
            begin, start = start, min(start + self._q - known, end)
            head = np.concatenate([self._pending[0], volts[begin:start]])
            rows = np.concatenate([self._pending[1], moved[:, begin:start]], axis=1)
            if len(head) < self._q:
                self._pending = head, rows.copy()
                self._solve_provisionally(head, rows, mask)
            else:
                self._pending = np.empty(0), np.empty((ROWS, 0))
                self._advance(head, rows, 0, self._q, mask)
            moved[:, begin:start] = rows[:, known:]
        stop = start + (end - start) // self._q * self._q
        if stop > start:
            self._advance(volts, moved, start, stop, mask)
        if stop < end:
            rest = moved[:, stop:end].copy()
            self._pending = volts[stop:end].copy(), rest.copy()
            self._solve_provisionally(self._pending[0], rest, mask)
            moved[:, stop:end] = rest

    def _solve_provisionally(self, volts: FloatArray, moved: FloatArray, mask: int) -> None:
        path, stepped = self._at.path.copy(), self._levels.stepped_samples
        frames = moved.shape[1]
        self._levels.solve(self._at.level, volts, moved, path, 0, (frames,) * 3, mask)
        self._levels.stepped_samples = stepped

    def _advance(
        self, volts: FloatArray, moved: FloatArray, start: int, stop: int, mask: int
    ) -> None:
        """Solve from node to node, block by block."""
        while start < stop:
            room = self._block - self._at.samples % self._block
            first = min(room, stop - start)
            frames = first
            if first == room and self.temperatures is None:
                frames += (stop - start - first) // self._block * self._block
            blocks_of = first, self._block, frames
            if self.level:
                rows = self._levels.solve(
                    self.level, volts, moved, self._at.path, start, blocks_of, mask
                )
                level = self.level
            else:
                level, rows = self._select(volts, moved, start, blocks_of, mask)
            done = first + (len(rows) - 1) * self._block
            self._report(level, rows, first)
            self._warm(moved, start, start + done)
            start += done

    def _select(
        self,
        volts: FloatArray,
        moved: FloatArray,
        start: int,
        blocks_of: tuple[int, int, int],
        mask: int,
    ) -> tuple[ModelLevel, FloatArray]:
        """Solve the next blocks by the linear model, or one by the non-linear model."""
        at, (first, each, _) = self._at, blocks_of
        estimates = self._estimate(volts, moved, start, blocks_of)
        level = ModelLevel.LINEAR if len(estimates) else ModelLevel.NONLINEAR
        old = None
        if level is not at.level and at.samples:
            faded = min(self._fade, first)
            before = moved[:, start : start + faded].copy()
            self._levels.solve(
                at.level,
                volts[start : start + faded],
                before,
                at.path.copy(),
                0,
                (faded,) * 3,
                mask,
            )
            old = before
        if level is ModelLevel.LINEAR:
            frames = first + (len(estimates) - 1) * each
            if at.level is not level:
                at.path.begin(at.path.d)
            if not self._levels.passes_linear(volts, moved, at.path, start + frames):
                self._levels.solve(level, volts, moved, at.path, start, (first, each, frames), mask)
            at.pair[(np.abs(at.pair) <= self._silent).all(axis=1)] = 0.0
            if (np.abs(at.path.d) <= self._silent).all():
                at.path.begin(np.zeros(5))
                at.pair[0] = 0.0
            rows = estimates
        else:
            if at.level is not level:
                at.path.begin(at.pair[1])
            frames = first
            while (
                frames < blocks_of[2]
                and old is None
                and self._is_alike(moved, start + frames, each)
            ):
                frames += each
            blocks_of = first, each, frames
            rows = self._levels.solve(level, volts, moved, at.path, start, blocks_of, mask)
            at.pair[:] = at.path.d
        at.level = level
        if old is not None:
            rows_asked = slice(0, ROWS if mask >> 4 else len(QUANTITIES))
            crossfade(
                moved[rows_asked, start : start + first],
                old[rows_asked],
                _FADE_SHARE * self.tolerance,
            )
        return level, rows

    def _estimate(
        self, volts: FloatArray, moved: FloatArray, start: int, blocks_of: tuple[int, int, int]
    ) -> FloatArray:
        """Return peaks and errors of the first blocks for which the linear model suffices.

        After a block that was beyond it, blocks that move as much are taken to be so as well.
        """
        first = blocks_of[0]
        if first < self._fade and self._at.level is ModelLevel.NONLINEAR:
            return np.empty((0, 4))  # too short for the crossfade that a change needs
        if self._is_alike(moved, start, first):
            return np.empty((0, 4))
        at = self._at
        estimates = self._levels.nonlinear.count_linear(
            volts, moved, at.path, at.pair, start, blocks_of, self.tolerance, MARGIN
        )
        if not len(estimates):
            self._beyond_m, self._trusted = self._reached_m(moved, start, first), _TRUSTED
        elif at.level is ModelLevel.NONLINEAR and self._flux_is_apart(moved[3, start:][:first]):
            return np.empty((0, 4))
        return estimates

    def _flux_is_apart(self, acceleration_m_s2: FloatArray) -> bool:
        """Return whether a change to the linear model would show in a block's acceleration."""
        p = self.rig.actuator
        force_n = p.force_factor_n_per_a * abs(self._at.path.d[FLUX]) / p.inductance_h
        peak_m_s2 = max(self._least_m_s2, float(np.abs(acceleration_m_s2).max(initial=0.0)))
        apart_m_s2 = _FLUX_SHARE * force_n / p.moving_mass_kg
        return bool(apart_m_s2 > self.tolerance * peak_m_s2)

    def _reached_m(self, moved: FloatArray, start: int, frames: int) -> float:
        return float(np.abs(moved[0, start : start + frames : self._q]).max())

    def _is_alike(self, moved: FloatArray, start: int, frames: int) -> bool:
        """Return whether a block moves as much as one that was beyond the linear model."""
        if not self._trusted or self._reached_m(moved, start, frames) < _ALIKE * self._beyond_m:
            return False
        self._trusted -= 1
        return True

    def _report(self, level: ModelLevel, rows: FloatArray, first: int) -> None:
        frames = first
        for peak_m, peak_m_s2, wrong_m, wrong_m_s2 in rows.tolist():
            estimate = wrong_m / max(peak_m, self._least_m)
            estimate = max(estimate, wrong_m_s2 / max(peak_m_s2, self._least_m_s2))
            self.reports.append(BlockReport(self._at.samples, frames, level, estimate, peak_m))
            self.frames_by_level[level] += frames
            self._at.samples += frames
            frames = self._block

    def _warm(self, moved: FloatArray, start: int, stop: int) -> None:
        if self.temperatures is None:
            return
        current_a = moved[2, start:stop]
        coil_ohm = self.equations.resistance_ohm - self.equations.source_impedance_ohm
        power_w = coil_ohm * float(np.mean(np.square(current_a)))
        self.temperatures.heat(power_w, (stop - start) / self.samplerate)
        self.equations.resistance_ohm = (
            self.temperatures.resistance_ohm(self.rig.actuator.resistance_ohm)
            + self.equations.source_impedance_ohm
        )
        self._at.path.fields["fresh"] = 1.0

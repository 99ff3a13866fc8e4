"""An actuator that models only what a scene needs: each block gets the cheapest sufficient model.

The exact linear solution of the whole signal is always there, and every other model adds to it
(model_levels.py). model_selection.py selects the model of each block. A more expensive model begins
with the best known state, and a change of model is crossfaded (segment.py).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from device.errors import UsageError
from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION, LinearActuator, Motion
from device.rig.co_energy import energies
from device.rig.equations import Equations
from device.rig.model_levels import ModelLevel, ModelLevels
from device.rig.model_selection import ModelSelector, SelectedModel
from device.rig.node_grid import NODES_HZ, NodeGrid
from device.rig.rig import Rig
from device.rig.segment import Correction, Segment, crossfade
from device.rig.thermal import Temperatures
from device.units import FloatArray, finite_or_zero

BLOCK_S = 0.1
FADE_S = 0.01
_FADE_SHARE = 0.5
"""A crossfade may deviate by this share of the tolerance."""
_MAX_NODES = 4_096
_MAX_TOGETHER = 16
"""Most linear blocks that are estimated together."""
_SILENT = 1e-18
"""Smaller values of d, in m, m/s and Wb, become 0."""
_ABSURD_V = 1e6
_REPORTS = 4_096


@dataclass(frozen=True)
class BlockReport:
    """How one block was computed."""

    frame: int  # number of the block's first frame since the start
    frames: int
    level: ModelLevel
    estimate: float  # predicted error as a share of the peak; 0 if the model was set
    excursion_peak_m: float


_Part = tuple[int, dict[str, FloatArray]]
"""Frames, and what to add to quantities of the linear solution there."""


class AdaptiveActuator:
    """One actuator with all its models; it keeps its state between blocks. One thread calls it.

    Between samples the voltage is a straight line, and it was 0 before the first. Samples after the
    last node are computed twice: provisionally, by extrapolating the linear solution, and for the
    state once their node exists. So the state does not depend on how the signal is split, except
    through the selection of models and the end of Newton's method.

    tolerance: allowed error of excursion and acceleration as a share of a block's peak, above 0.
    level: use this model always, whatever its error. seat, temperature: the actuator is on the
    rig's seat instead of solid ground; the coil warms up. nodes_hz: node rate of the non-linear
    model. early: make no estimate for blocks that surely need the non-linear model.
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
        nodes_hz: float = NODES_HZ,
        early: bool = True,
    ) -> None:
        if not (math.isfinite(tolerance) and tolerance > 0):
            raise UsageError(f"tolerance={tolerance!r} must be above 0; 1e-3 is usual")
        for wanted, name in ((seat, "seat"), (temperature, "thermal")):
            if wanted and getattr(rig, name) is None:
                raise UsageError(f"rig {rig.name!r} describes no [{name}]; add it to its file")
        source = rig.amplifier.source_impedance_ohm
        if rig.large_signal is None and not (seat or temperature):
            level = level or ModelLevel.LINEAR  # there is no remainder
        self.rig, self.samplerate, self.tolerance, self.level = rig, samplerate, tolerance, level
        LinearActuator(rig.actuator, samplerate, source)  # refuses what is out of range
        self._grid = NodeGrid(samplerate, nodes_hz)
        self._base = LinearActuator(rig.actuator, self._grid.samplerate, source)
        self.equations = Equations(
            rig.actuator,
            energies(rig.actuator, rig.large_signal),
            source,
            rig.seat if seat else None,
        )
        self._levels = ModelLevels(self.equations, self._grid)
        self.temperatures: Temperatures | None = None
        if temperature and rig.thermal:
            self.temperatures = Temperatures(rig.thermal)
        step_s = self._grid.spacing / self._grid.samplerate
        self._block_nodes = _MAX_NODES
        if level is None or temperature:
            self._block_nodes = max(1, round(BLOCK_S / step_s))
        self._fade_nodes = max(1, round(FADE_S / step_s))
        self._selector = ModelSelector(self._levels, tolerance, early)
        self.reset()

    def reset(self) -> None:
        """Come to rest, cool down, and clear reports and counts."""
        self._base.reset()
        self._grid.reset()
        self._levels.reset()
        self._selector.reset()
        if self.temperatures:
            self.temperatures.reset()
        self.equations.resistance_ohm = self.equations.linear_resistance_ohm
        self.replaced_samples = 0  # volts that were not finite or above 1e6 and became 0
        self.reports: deque[BlockReport] = deque(maxlen=_REPORTS)
        self.frames_by_level = dict.fromkeys(ModelLevel, 0)
        self._last_level = self.level or ModelLevel.LINEAR
        self._estimates_several = self.level is None and self.temperatures is None
        self._together = 2 if self._estimates_several else 1
        self._d = self._under = self._better = np.zeros(self.equations.states)
        self._nodes_done = 0
        # Before the first sample the actuator is at rest: that is the first node.
        self._pending = Segment(*(np.zeros(1) for _ in range(5)))

    @property
    def stepped_frames(self) -> int:
        """Frames so far that were solved step by step, whatever model was selected."""
        return self._levels.stepped_samples // self._grid.upsampling

    @property
    def iterations(self) -> int:
        """Iterations of Newton's method so far, each over a whole block."""
        return self._levels.iterations

    def move(self, volts: FloatArray, outputs: Sequence[str] = QUANTITIES) -> Motion:
        """Return the motion under the amplifier's next open-circuit volts, (frames,).

        It is always finite. Of the `outputs`, seat_acceleration_m_s2 needs a seat.
        """
        finite, replaced = finite_or_zero(np.asarray(volts, dtype=np.float64), _ABSURD_V)
        self.replaced_samples += replaced
        fine = self._grid.upsample(np.ascontiguousarray(finite))
        motion = self._base.move(fine)
        known = len(self._pending.volts)
        every = (fine, *(getattr(motion, name) for name in QUANTITIES))
        whole = Segment(
            *(
                np.concatenate([before, new])
                for before, new in zip(vars(self._pending).values(), every, strict=True)
            )
        )
        names = [name for name in (*QUANTITIES, SEAT_ACCELERATION) if name in outputs]
        parts = self._solve_parts(whole, names)
        nothing: FloatArray = np.empty(0)
        computed = dict.fromkeys((*QUANTITIES, SEAT_ACCELERATION), nothing)
        computed |= {name: getattr(motion, name) for name in names}
        if SEAT_ACCELERATION in names:
            computed[SEAT_ACCELERATION] = self._levels.frame_share(motion.acceleration_m_s2)
        # Add in place, because large arrays are expensive; the models have a copy of their own.
        first = 1 - known
        for frames, part in parts:
            for name, added in part.items():
                computed[name][max(first, 0) : first + frames] += added[max(-first, 0) :]
            first += frames
        signal = slice(self._grid.upsampling - 1, None, self._grid.upsampling)
        return Motion(**{name: total[signal] for name, total in computed.items()})

    def _solve_parts(self, whole: Segment, names: Sequence[str]) -> list[_Part]:
        """Return what to add to each sample after the first; advance the state to the last node."""
        q, samples = self._grid.spacing, len(whole.volts) - 1
        parts = []
        done = 0
        while done < samples // q:
            room = self._block_nodes - self._nodes_done % self._block_nodes
            linear = nonlinear = 0
            if self._estimates_several and room == self._block_nodes:
                blocks = min(_MAX_TOGETHER, (samples // q - done) // room)
                ahead = whole.part(done * q, (done + blocks * room) * q)
                nonlinear = self._selector.count_nonlinear(ahead, room)
                if self._together > 1 and not nonlinear:
                    linear = self._count_linear(ahead.part(0, self._together * room * q))
            steps = min(max(linear, nonlinear, 1) * room, samples // q - done)
            segment = whole.part(done * q, (done + steps) * q)
            if linear:
                found = self._levels.solve(ModelLevel.LINEAR, segment, self._d, self._d)
                parts.append(self._part(found, names, steps * q))
                self._advance(found, self._better)
            else:
                parts.append(self._solve_block(segment, names, steps * q, nonlinear))
            done += steps
            self._nodes_done += steps
        self._pending = whole.part(done * q, samples)
        if rest := samples - done * q:
            segment = self._pending.extend(q, 1.0 / self._grid.samplerate)
            found = self._levels.solve(self._last_level, segment, self._d, self._under)
            parts.append(self._part(found, names, rest))
        return parts

    def _part(self, found: Correction, names: Sequence[str], frames: int) -> _Part:
        """Return what a correction adds to its first frames."""
        added = () if found.is_zero else names
        return frames, {name: found.samples(name)[:frames] for name in added}

    def _count_linear(self, segment: Segment) -> int:
        """Return for how many of the first blocks the linear model suffices, and report them."""
        if len(segment.volts) == 1:
            return 0
        length, q = self._block_nodes, self._grid.spacing
        linear = self._selector.find_linear(segment, self._d, self._better, length)
        frames = length * q // self._grid.upsampling
        frame = self._nodes_done * frames // length
        for estimate, peak_m in zip(linear.estimates, linear.peaks_m, strict=True):
            self.reports.append(BlockReport(frame, frames, ModelLevel.LINEAR, estimate, peak_m))
            self.frames_by_level[ModelLevel.LINEAR] += frames
            frame += frames
        found = len(linear.estimates)
        if found:
            self._better = linear.better
        all_of_them = found == (len(segment.volts) - 1) // (q * length)
        self._together = min(2 * self._together, _MAX_TOGETHER) if all_of_them else 1
        return found

    def _solve_block(
        self, segment: Segment, names: Sequence[str], frames: int, nonlinear: int
    ) -> _Part:
        """Solve one block, or several that surely need the non-linear model."""
        steps, start = (len(segment.volts) - 1) // self._grid.spacing, self._d
        if self.level:
            found = self._levels.solve(self.level, segment, start, start)
            selected = SelectedModel(self.level, 0.0, found, found.end)
        elif nonlinear:
            selected = self._selector.solve_nonlinear(segment, self._better)
        else:
            selected = self._selector.select(segment, start, self._better)
        level, estimate, found, better, above = selected
        part = self._part(found, names, frames)
        blocks = max(nonlinear, 1)
        # Each block of a corrected model has its own remainder, so it needs a crossfade as well.
        if level is not self._last_level or level is ModelLevel.CORRECTED:
            faded = min(steps, self._fade_nodes) * self._grid.spacing
            if above and self._last_level is ModelLevel.NONLINEAR:
                # It starts at the same state as the non-linear model and is computed already.
                old = above
            else:
                before = segment.part(0, faded)
                old = self._levels.solve(self._last_level, before, start, self._under)
            inside = frames // blocks
            first = segment.part(0, inside)
            for name, values in part[1].items():
                base = getattr(first, name, None)
                going_on = old.samples(name)[:faded]
                crossfade(values[:inside], going_on, base, _FADE_SHARE * self.tolerance)
        self._together = 2 if level is ModelLevel.LINEAR and self._estimates_several else 1
        self._last_level = level
        self._advance(found, better)
        shown = frames // blocks // self._grid.upsampling
        frame = self._nodes_done * self._grid.spacing // self._grid.upsampling
        self.frames_by_level[level] += shown * blocks
        for peak_m in found.excursion_peaks_m(blocks):
            self.reports.append(BlockReport(frame, shown, level, estimate, peak_m))
            frame += shown
        self._warm(segment, found)
        return part

    def _advance(self, found: Correction, better: FloatArray) -> None:
        """Keep the state for the next block.

        A more expensive model begins with `better`, the state of the next better model, so that no
        error of a cheap model rings on in a block that does not tolerate it.
        """
        self._d, self._under, self._better = found.end, found.under_end, better
        if max(np.abs(self._d).max(), np.abs(better).max()) < _SILENT:
            self._d = self._under = self._better = np.zeros_like(self._d)

    def _warm(self, segment: Segment, found: Correction) -> None:
        if self.temperatures is None:
            return
        current = segment.current_a[1:] + found.samples("current_a")
        coil_ohm = self.equations.resistance_ohm - self.equations.source_impedance_ohm
        power_w = coil_ohm * float(np.mean(np.square(current)))
        self.temperatures.heat(power_w, len(current) / self._grid.samplerate)
        self.equations.resistance_ohm = (
            self.temperatures.resistance_ohm(self.rig.actuator.resistance_ohm)
            + self.equations.source_impedance_ohm
        )

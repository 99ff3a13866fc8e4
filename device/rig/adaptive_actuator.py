"""Model only what a scene needs: block by block the cheapest level that keeps the tolerance.

The linear solution of the whole signal is always there, exact, and every other level adds to it
(levels.py). Before a block is settled its level is chosen (choice.py); a dearer one begins with the
best that is known of the state. At a change of level both are heard for a while (hand_over.py).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from device.errors import UsageError
from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION, LinearActuator, Motion
from device.rig.co_energy import energies
from device.rig.equations import Equations
from device.rig.model_levels import ModelLevel, ModelLevels
from device.rig.model_selection import ModelSelector
from device.rig.node_grid import NODES_HZ, NodeGrid
from device.rig.rig import Rig
from device.rig.segment import Correction, Segment, crossfade
from device.rig.thermal import Temperatures
from device.units import FloatArray, finite_or_zero


@dataclass(frozen=True)
class BlockReport:
    """How one block was computed.

    frame: its first one since the start; frames; level; estimate: of the error, as a share of the
    block's peak excursion or acceleration, 0 where a level was asked for; excursion_peak_m.
    """

    frame: int
    frames: int
    level: ModelLevel
    estimate: float
    excursion_peak_m: float


BLOCK_S = 0.1
FADE_S = 0.01
_FADE_SHARE = 0.5
"""Of the tolerance, that a fade from level to level may be off by."""
_LONGEST_NODES = 4_096
_MOST_TOGETHER = 16
_SILENT = 1e-18
"""Below it, in m, m/s and Wb, what another level has left is gone."""
_ABSURD_V = 1e6
_REPORTS = 4_096


class _Part(NamedTuple):
    """What is to be added to so many samples of the linear solution; absent quantities stay."""

    frames: int
    added: dict[str, FloatArray]


class AdaptiveActuator:
    """One actuator with all its levels; holds its state between blocks. One thread calls it.

    tolerance: error of excursion and acceleration as a share of a block's peak, above 0. level:
    always this one, whatever the error. seat: on the rig's seat, else on the ground; temperature:
    the coil warms up. nodes_hz: of the non-linear level. early: no estimate where choice.py is sure
    that only the non-linear level will do.

    Between samples the voltage is a straight line, and it was 0 before the first. The samples
    after the last node, less than one step, are computed provisionally, as if the linear solution
    went on evenly, and once more, for the state, when their node is there: so the state does not
    depend on how the signal is split but for the choice of levels and the end of Newton's method.

    equations: what all levels solve. replaced_samples: volts that were not finite, or above 1e6,
    and were taken as 0, so far.
    reports: of the last few thousand blocks. frames_by_level: so far. stepped_frames: so far,
    whatever level had been chosen for them. temperatures: None if they are not modelled.

    Raises
    ------
    UsageError
        The rate or the tolerance is out of range, or the rig does not say what is asked for.
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
        self._block_nodes = _LONGEST_NODES
        if level is None or temperature:
            self._block_nodes = max(1, round(BLOCK_S / step_s))
        self._fade_nodes = max(1, round(FADE_S / step_s))
        self._step_s = step_s
        self._choice = ModelSelector(self._levels, tolerance, early)
        self.reset()

    def reset(self) -> None:
        """Come to rest, cool down, forget reports and counts."""
        self._base.reset()
        self._grid.reset()
        self._levels.reset()
        self._choice.reset()
        if self.temperatures:
            self.temperatures.reset()
        self.equations.resistance_ohm = self.equations.linear_resistance_ohm
        self.replaced_samples = 0
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
        """Frames so far that the step by step level computed."""
        return self._levels.stepped_samples // self._grid.upsampling

    @property
    def iterations(self) -> int:
        """Of Newton's method so far, each over a whole block."""
        return self._levels.iterations

    def move(self, volts: FloatArray, outputs: Sequence[str] = QUANTITIES) -> Motion:
        """The motion while the next volts, (frames,), are applied: always finite.

        outputs: what to compute, of `Motion`; seat_acceleration_m_s2 with a seat only.
        """
        sound, replaced = finite_or_zero(np.asarray(volts, dtype=np.float64), _ABSURD_V)
        self.replaced_samples += replaced
        fine = self._grid.upsampled(np.ascontiguousarray(sound))
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
        parts = self._settled(whole, names)
        nothing: FloatArray = np.empty(0)
        computed = dict.fromkeys((*QUANTITIES, SEAT_ACCELERATION), nothing)
        for name in names:
            total = getattr(motion, name)
            if name == SEAT_ACCELERATION:
                total = self._levels.frame_share(motion.acceleration_m_s2)
            computed[name] = total
        # In place, as large arrays are dear to make: the linear solution was copied for the levels.
        first = 1 - known
        for part in parts:
            for name, added in part.added.items():
                computed[name][max(first, 0) : first + part.frames] += added[max(-first, 0) :]
            first += part.frames
        every_one = slice(self._grid.upsampling - 1, None, self._grid.upsampling)
        return Motion(**{name: total[every_one] for name, total in computed.items()})

    def _settled(self, whole: Segment, names: Sequence[str]) -> list[_Part]:
        """What to add to each sample after the first; the state goes on to the last node."""
        q, samples = self._grid.spacing, len(whole.volts) - 1
        parts = []
        done = 0
        while done < samples // q:
            room = self._block_nodes - self._nodes_done % self._block_nodes
            quiet = sure = 0
            if self._estimates_several and room == self._block_nodes:
                blocks = min(_MOST_TOGETHER, (samples // q - done) // room)
                ahead = whole.part(done * q, (done + blocks * room) * q)
                sure = self._choice.sure(ahead, room)
                if self._together > 1 and not sure:
                    quiet = self._quiet_blocks(ahead.part(0, self._together * room * q))
            steps = min(max(quiet, sure, 1) * room, samples // q - done)
            segment = whole.part(done * q, (done + steps) * q)
            if quiet:
                found = self._levels.answer(ModelLevel.LINEAR, segment, self._d, self._d)
                parts.append(self._part(found, names, steps * q))
                self._go_on(found, self._better)
            else:
                parts.append(self._block(segment, names, steps * q, sure))
            done += steps
            self._nodes_done += steps
        self._pending = whole.part(done * q, samples)
        if rest := samples - done * q:
            segment = self._pending.extend(q, 1.0 / self._grid.samplerate)
            found = self._levels.answer(self._last_level, segment, self._d, self._under)
            parts.append(self._part(found, names, rest))
        return parts

    def _part(self, found: Correction, names: Sequence[str], frames: int) -> _Part:
        """What a correction adds to its first frames."""
        if found.is_zero:
            return _Part(frames, {})
        return _Part(frames, {name: found.samples(name)[:frames] for name in names})

    def _quiet_blocks(self, segment: Segment) -> int:
        """How many of several blocks, from the first on, are linear enough; they are reported."""
        if len(segment.volts) == 1:
            return 0
        length, q = self._block_nodes, self._grid.spacing
        quiet = self._choice.quiet(segment, self._d, self._better, length)
        frames = length * q // self._grid.upsampling
        frame = self._nodes_done * frames // length
        for estimate, peak_m in zip(quiet.estimates, quiet.peaks_m, strict=True):
            self.reports.append(BlockReport(frame, frames, ModelLevel.LINEAR, estimate, peak_m))
            self.frames_by_level[ModelLevel.LINEAR] += frames
            frame += frames
        found = len(quiet.estimates)
        if found:
            self._better = quiet.better
        all_of_them = found == (len(segment.volts) - 1) // (q * length)
        self._together = min(2 * self._together, _MOST_TOGETHER) if all_of_them else 1
        return found

    def _block(self, segment: Segment, names: Sequence[str], frames: int, sure: int) -> _Part:
        """One block, or several of which it is sure that they need the non-linear level."""
        steps, start = (len(segment.volts) - 1) // self._grid.spacing, self._d
        above = None
        if self.level:
            level, estimate = self.level, 0.0
            found = self._levels.answer(level, segment, start, start)
            better = found.end
        elif sure:
            level, estimate, found, better, _ = self._choice.dearest(segment, self._better)
        else:
            chosen = self._choice.one(segment, start, self._better)
            level, estimate, found, better, above = chosen
        part = self._part(found, names, frames)
        # A correction does not go on from block to block evenly: each has a remainder of its own.
        if level is not self._last_level or level is ModelLevel.CORRECTED:
            faded = min(steps, self._fade_nodes) * self._grid.spacing
            if above and self._last_level is ModelLevel.NONLINEAR:
                # From one state on it begins as the non-linear level does, and is there already.
                old = above
            else:
                before = segment.part(0, faded)
                old = self._levels.answer(self._last_level, before, start, self._under)
            inside = frames // max(sure, 1)
            first = segment.part(0, inside)
            for name, values in part.added.items():
                base = getattr(first, name, None)
                going_on = old.samples(name)[:faded]
                crossfade(values[:inside], going_on, base, _FADE_SHARE * self.tolerance)
        self._together = 2 if level is ModelLevel.LINEAR and self._estimates_several else 1
        self._last_level = level
        self._go_on(found, better)
        blocks = max(sure, 1)
        shown = frames // blocks // self._grid.upsampling
        frame = self._nodes_done * self._grid.spacing // self._grid.upsampling
        self.frames_by_level[level] += shown * blocks
        for peak_m in found.excursion_peaks_m(blocks):
            self.reports.append(BlockReport(frame, shown, level, estimate, peak_m))
            frame += shown
        self._warm(segment, found)
        return part

    def _go_on(self, found: Correction, better: FloatArray) -> None:
        """Hand the state over to what comes next.

        better: what the level above says of the state; whatever is dearer than this one begins
        there, so that no error of a cheap level rings on in a block that cannot bear it.
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

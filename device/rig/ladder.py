"""Model only what a scene needs: block by block the cheapest rung that keeps the tolerance.

The linear solution of the whole signal is always there, exact, and every other rung adds to it
(rungs.py). Before a block is settled its rung is chosen (choice.py); a dearer one begins with the
best that is known of the state. At a change of rung both are heard for a while (hand_over.py).
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from device.errors import UsageError
from device.rig.actuator import SEAT_ACCELERATION, LinearActuator, Motion
from device.rig.block_report import BlockReport
from device.rig.choice import Choice
from device.rig.co_energy import energies
from device.rig.correction import Correction
from device.rig.equations import Equations
from device.rig.hand_over import fade
from device.rig.linear_system import QUANTITIES
from device.rig.node_grid import NODES_HZ, NodeGrid
from device.rig.rig import Rig
from device.rig.rungs import Rung, Rungs
from device.rig.stretch import Stretch
from device.rig.thermal import Temperatures
from device.units import FloatArray, finite_or_zero

BLOCK_S = 0.1
FADE_S = 0.01
_FADE_SHARE = 0.5
"""Of the tolerance, that a fade from rung to rung may be off by."""
_LONGEST_NODES = 4_096
_MOST_TOGETHER = 16
_SILENT = 1e-18
"""Below it, in m, m/s and Wb, what another rung has left is gone."""
_ABSURD_V = 1e6
_REPORTS = 4_096


class _Part(NamedTuple):
    """What is to be added to so many samples of the linear solution; absent quantities stay."""

    frames: int
    added: dict[str, FloatArray]


class Ladder:
    """One actuator with all its rungs; holds its state between blocks. One thread calls it.

    tolerance: error of excursion and acceleration as a share of a block's peak, above 0. rung:
    always this one, whatever the error. seat: on the rig's seat, else on the ground; temperature:
    the coil warms up. nodes_hz: of the non-linear rung. early: no estimate where choice.py is sure
    that only the non-linear rung will do.

    Between samples the voltage is a straight line, and it was 0 before the first. The samples
    after the last node, less than one step, are computed provisionally, as if the linear solution
    went on evenly, and once more, for the state, when their node is there: so the state does not
    depend on how the signal is split but for the choice of rungs and the end of Newton's method.

    equations: what all rungs solve. replaced_samples: volts that were not finite, or above 1e6,
    and were taken as 0, so far.
    reports: of the last few thousand blocks. frames_by_rung: so far. stepped_frames: so far,
    whatever rung had been chosen for them. temperatures: None if they are not modelled.

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
        rung: Rung | None = None,
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
            rung = rung or Rung.LINEAR  # there is no remainder
        self.rig, self.samplerate, self.tolerance, self.rung = rig, samplerate, tolerance, rung
        LinearActuator(rig.actuator, samplerate, source)  # refuses what is out of range
        self._grid = NodeGrid(samplerate, nodes_hz)
        self._base = LinearActuator(rig.actuator, self._grid.samplerate, source)
        self.equations = Equations(
            rig.actuator,
            energies(rig.actuator, rig.large_signal),
            source,
            rig.seat if seat else None,
        )
        self._rungs = Rungs(self.equations, self._grid)
        self.temperatures: Temperatures | None = None
        if temperature and rig.thermal:
            self.temperatures = Temperatures(rig.thermal)
        step_s = self._grid.spacing / self._grid.samplerate
        self._block_nodes = _LONGEST_NODES
        if rung is None or temperature:
            self._block_nodes = max(1, round(BLOCK_S / step_s))
        self._fade_nodes = max(1, round(FADE_S / step_s))
        self._step_s = step_s
        self._choice = Choice(self._rungs, tolerance, early)
        self.reset()

    def reset(self) -> None:
        """Come to rest, cool down, forget reports and counts."""
        self._base.reset()
        self._grid.reset()
        self._rungs.reset()
        self._choice.reset()
        if self.temperatures:
            self.temperatures.reset()
        self.equations.resistance_ohm = self.equations.linear_resistance_ohm
        self.replaced_samples = 0
        self.reports: deque[BlockReport] = deque(maxlen=_REPORTS)
        self.frames_by_rung = dict.fromkeys(Rung, 0)
        self._last_rung = self.rung or Rung.LINEAR
        self._estimates_several = self.rung is None and self.temperatures is None
        self._together = 2 if self._estimates_several else 1
        self._d = self._under = self._better = np.zeros(self.equations.states)
        self._nodes_done = 0
        # Before the first sample the actuator is at rest: that is the first node.
        self._pending = Stretch(*(np.zeros(1) for _ in range(5)))

    @property
    def stepped_frames(self) -> int:
        """Frames so far that the step by step rung computed."""
        return self._rungs.stepped_samples // self._grid.upsampling

    @property
    def iterations(self) -> int:
        """Of Newton's method so far, each over a whole block."""
        return self._rungs.iterations

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
        whole = Stretch(
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
                total = self._rungs.frame_share(motion.acceleration_m_s2)
            computed[name] = total
        # In place, as large arrays are dear to make: the linear solution was copied for the rungs.
        first = 1 - known
        for part in parts:
            for name, added in part.added.items():
                computed[name][max(first, 0) : first + part.frames] += added[max(-first, 0) :]
            first += part.frames
        every_one = slice(self._grid.upsampling - 1, None, self._grid.upsampling)
        return Motion(**{name: total[every_one] for name, total in computed.items()})

    def _settled(self, whole: Stretch, names: Sequence[str]) -> list[_Part]:
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
            stretch = whole.part(done * q, (done + steps) * q)
            if quiet:
                found = self._rungs.answer(Rung.LINEAR, stretch, self._d, self._d)
                parts.append(self._part(found, names, steps * q))
                self._go_on(found, self._better)
            else:
                parts.append(self._block(stretch, names, steps * q, sure))
            done += steps
            self._nodes_done += steps
        self._pending = whole.part(done * q, samples)
        if rest := samples - done * q:
            stretch = self._pending.extended(q, 1.0 / self._grid.samplerate)
            found = self._rungs.answer(self._last_rung, stretch, self._d, self._under)
            parts.append(self._part(found, names, rest))
        return parts

    def _part(self, found: Correction, names: Sequence[str], frames: int) -> _Part:
        """What a correction adds to its first frames."""
        if found.is_nothing:
            return _Part(frames, {})
        return _Part(frames, {name: found.samples(name)[:frames] for name in names})

    def _quiet_blocks(self, stretch: Stretch) -> int:
        """How many of several blocks, from the first on, are linear enough; they are reported."""
        if len(stretch.volts) == 1:
            return 0
        length, q = self._block_nodes, self._grid.spacing
        quiet = self._choice.quiet(stretch, self._d, self._better, length)
        frames = length * q // self._grid.upsampling
        frame = self._nodes_done * frames // length
        for estimate, peak_m in zip(quiet.estimates, quiet.peaks_m, strict=True):
            self.reports.append(BlockReport(frame, frames, Rung.LINEAR, estimate, peak_m))
            self.frames_by_rung[Rung.LINEAR] += frames
            frame += frames
        found = len(quiet.estimates)
        if found:
            self._better = quiet.better
        all_of_them = found == (len(stretch.volts) - 1) // (q * length)
        self._together = min(2 * self._together, _MOST_TOGETHER) if all_of_them else 1
        return found

    def _block(self, stretch: Stretch, names: Sequence[str], frames: int, sure: int) -> _Part:
        """One block, or several of which it is sure that they need the non-linear rung."""
        steps, start = (len(stretch.volts) - 1) // self._grid.spacing, self._d
        above = None
        if self.rung:
            rung, estimate = self.rung, 0.0
            found = self._rungs.answer(rung, stretch, start, start)
            better = found.end
        elif sure:
            rung, estimate, found, better, _ = self._choice.dearest(stretch, self._better)
        else:
            chosen = self._choice.one(stretch, start, self._better)
            rung, estimate, found, better, above = chosen
        part = self._part(found, names, frames)
        # A correction does not go on from block to block evenly: each has a remainder of its own.
        if rung is not self._last_rung or rung is Rung.CORRECTED:
            faded = min(steps, self._fade_nodes) * self._grid.spacing
            if above and self._last_rung is Rung.NONLINEAR:
                # From one state on it begins as the non-linear rung does, and is there already.
                old = above
            else:
                before = stretch.part(0, faded)
                old = self._rungs.answer(self._last_rung, before, start, self._under)
            inside = frames // max(sure, 1)
            first = stretch.part(0, inside)
            for name, values in part.added.items():
                base = getattr(first, name, None)
                going_on = old.samples(name)[:faded]
                fade(values[:inside], going_on, base, _FADE_SHARE * self.tolerance)
        self._together = 2 if rung is Rung.LINEAR and self._estimates_several else 1
        self._last_rung = rung
        self._go_on(found, better)
        blocks = max(sure, 1)
        shown = frames // blocks // self._grid.upsampling
        frame = self._nodes_done * self._grid.spacing // self._grid.upsampling
        self.frames_by_rung[rung] += shown * blocks
        for peak_m in found.excursion_peaks_m(blocks):
            self.reports.append(BlockReport(frame, shown, rung, estimate, peak_m))
            frame += shown
        self._warm(stretch, found)
        return part

    def _go_on(self, found: Correction, better: FloatArray) -> None:
        """Hand the state over to what comes next.

        better: what the rung above says of the state; whatever is dearer than this one begins
        there, so that no error of a cheap rung rings on in a block that cannot bear it.
        """
        self._d, self._under, self._better = found.end, found.under_end, better
        if max(np.abs(self._d).max(), np.abs(better).max()) < _SILENT:
            self._d = self._under = self._better = np.zeros_like(self._d)

    def _warm(self, stretch: Stretch, found: Correction) -> None:
        if self.temperatures is None:
            return
        current = stretch.current_a[1:] + found.samples("current_a")
        coil_ohm = self.equations.resistance_ohm - self.equations.source_impedance_ohm
        power_w = coil_ohm * float(np.mean(np.square(current)))
        self.temperatures.heat(power_w, len(current) / self._grid.samplerate)
        self.equations.resistance_ohm = (
            self.temperatures.resistance_ohm(self.rig.actuator.resistance_ohm)
            + self.equations.source_impedance_ohm
        )

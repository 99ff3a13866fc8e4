"""Model only what a scene needs: block by block the cheapest rung that keeps the tolerance.

The linear solution of the whole signal is always there, exact, and every other rung adds to it
(rungs.py). Before a block is settled its error is estimated: that of the linear rung by 1.5 times
the Born term, that of the Born term by 1.5 times what a second one would change. Either begins
with the best that is known of the state, so what cheap rungs of earlier blocks have left ringing
is in the estimate; and a dearer rung begins there.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from device.errors import UsageError
from device.rig.actuator import SEAT_ACCELERATION, LinearActuator, Motion
from device.rig.co_energy import energies
from device.rig.equations import Equations
from device.rig.error_estimate import ErrorEstimate, difference
from device.rig.linear_system import QUANTITIES
from device.rig.node_grid import NODES_HZ, NodeGrid
from device.rig.rig import Rig
from device.rig.rungs import Correction, Rung, Rungs, Stretch
from device.rig.thermal import Temperatures
from device.units import FloatArray, finite_or_zero

BLOCK_S = 0.1
FADE_S = 0.01
_NONLINEAR_ERROR = 1e-6
"""Of the non-linear rung, as a share of the peak: it is carried, too."""
_LONGEST_NODES = 4_096
_MOST_TOGETHER = 16
_SILENT = 1e-18
"""Below it, in m, m/s and Wb, what another rung has left is gone."""
_ABSURD_V = 1e6
_REPORTS = 4_096


@dataclass(frozen=True)
class BlockReport:
    """How one block was computed.

    frame: its first one since the start; frames; rung; estimate: of the error, as a share of the
    block's peak excursion or acceleration, 0 where a rung was asked for; excursion_peak_m.
    """

    frame: int
    frames: int
    rung: Rung
    estimate: float
    excursion_peak_m: float


class _Part(NamedTuple):
    """What is to be added to so many samples of the linear solution; absent quantities stay."""

    frames: int
    added: dict[str, FloatArray]


class Ladder:
    """One actuator with all its rungs; holds its state between blocks. One thread calls it.

    tolerance: error of excursion and acceleration as a share of a block's peak, above 0. rung:
    always this one, whatever the error. seat: on the rig's seat, else on the ground; temperature:
    the coil warms up. nodes_hz: of the non-linear rung.

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
        self._errors = ErrorEstimate(rig.actuator)
        self.reset()

    def reset(self) -> None:
        """Come to rest, cool down, forget reports and counts."""
        self._base.reset()
        self._grid.reset()
        self._rungs.reset()
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
            quiet = 0
            if self._together > 1 and room == self._block_nodes:
                together = min(self._together, (samples // q - done) // room) * room
                quiet = self._quiet_blocks(whole.part(done * q, (done + together) * q))
            steps = min(max(quiet, 1) * room, samples // q - done)
            stretch = whole.part(done * q, (done + steps) * q)
            if quiet:
                found = self._by(Rung.LINEAR, stretch, self._d, self._d)
                parts.append(self._part(found, names, steps * q))
                self._go_on(found, self._better)
            else:
                parts.append(self._block(stretch, names, steps * q))
            done += steps
            self._nodes_done += steps
        self._pending = whole.part(done * q, samples)
        if rest := samples - done * q:
            stretch = _extended(self._pending, q, 1.0 / self._grid.samplerate)
            found = self._by(self._last_rung, stretch, self._d, self._under)
            parts.append(self._part(found, names, rest))
        return parts

    def _part(self, found: Correction, names: Sequence[str], frames: int) -> _Part:
        """What a correction adds to its first frames."""
        if found.is_nothing:
            return _Part(frames, {})
        return _Part(frames, {name: found.samples(name)[:frames] for name in names})

    def _quiet_blocks(self, stretch: Stretch) -> int:
        """How many of several blocks, from the first on, are linear enough; they are reported.

        One estimate for all of them is cheaper, and what earlier ones leave is in it.
        """
        if len(stretch.volts) == 1:
            return 0
        rungs, start, length = self._rungs, self._d, self._block_nodes
        bases = rungs.bases(stretch, self._grid.spacing)
        linear = rungs.linear(bases, start)
        born, _ = rungs.corrected(bases, self._better, linear)
        frames = length * self._grid.spacing // self._grid.upsampling
        blocks = (len(bases[0].excursion_m) - 1) // length
        quiet = 0
        for block in range(blocks):
            nodes = slice(block * length, (block + 1) * length + 1)
            change = difference(born, linear, nodes)
            estimate = self._errors.share(change, self._errors.peaks(bases, born, nodes))
            if estimate > self.tolerance:
                break
            frame = (self._nodes_done + block * length) * frames // length
            peak_m = float(np.abs(bases[0].excursion_m[nodes] + linear.nodes[0, nodes]).max())
            self.reports.append(BlockReport(frame, frames, Rung.LINEAR, estimate, peak_m))
            self.frames_by_rung[Rung.LINEAR] += frames
            quiet += 1
        if quiet:
            self._better = born.nodes[:, quiet * length].copy()
        self._together = min(2 * self._together, _MOST_TOGETHER) if quiet == blocks else 1
        return quiet

    def _block(self, stretch: Stretch, names: Sequence[str], frames: int) -> _Part:
        steps, start = (len(stretch.volts) - 1) // self._grid.spacing, self._d
        if self.rung:
            rung, estimate = self.rung, 0.0
            found = self._by(rung, stretch, start, start)
            better = found.end
        else:
            rung, estimate, found, better = self._chosen(stretch)
        part = self._part(found, names, frames)
        # A correction does not go on from block to block evenly: each has a remainder of its own.
        if rung is not self._last_rung or rung is Rung.CORRECTED:
            faded = min(steps, self._fade_nodes) * self._grid.spacing
            old = self._by(self._last_rung, stretch.part(0, faded), start, self._under)
            for name, values in part.added.items():
                self._fade(values, old.samples(name), getattr(stretch, name, None))
        self._together = 2 if rung is Rung.LINEAR and self._estimates_several else 1
        self._last_rung = rung
        self._go_on(found, better)
        shown = frames // self._grid.upsampling
        frame = self._nodes_done * self._grid.spacing // self._grid.upsampling
        self.frames_by_rung[rung] += shown
        self.reports.append(BlockReport(frame, shown, rung, estimate, found.excursion_peak_m))
        self._warm(stretch, found)
        return part

    def _fade(self, values: FloatArray, old: FloatArray, base: FloatArray | None) -> None:
        """From what went on before to what is chosen now, in place.

        Where the old rung goes wrong before it is faded out, as at the beginning of a burst, only
        the jump between the two is.
        """
        frames = len(old)
        weight = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, frames + 1) / frames)
        apart = old - values[:frames]
        whole = values if base is None else values + base[1:]
        allowed = 0.5 * self.tolerance * float(np.abs(whole).max())
        if float(np.abs(apart * weight).max()) > allowed:
            apart = np.full(frames, apart[0])
        values[:frames] += apart * weight

    def _go_on(self, found: Correction, better: FloatArray) -> None:
        """Hand the state over to what comes next.

        better: what the rung above says of the state; whatever is dearer than this one begins
        there, so that no error of a cheap rung rings on in a block that cannot bear it.
        """
        self._d, self._under, self._better = found.end, found.under_end, better
        if max(np.abs(self._d).max(), np.abs(better).max()) < _SILENT:
            self._d = self._under = self._better = np.zeros_like(self._d)

    def _by(self, rung: Rung, stretch: Stretch, start: FloatArray, under: FloatArray) -> Correction:
        """One rung's answer; under: where the path begins whose remainder a correction takes."""
        rungs = self._rungs
        if rung is Rung.LINEAR and self.equations.seat is None and not np.any(start):
            return rungs.nothing(stretch)
        if rung is Rung.STEPPED:
            return rungs.stepped(stretch, start)
        bases = rungs.bases(stretch, self._grid.spacing)
        linear = rungs.linear(bases, under if rung is Rung.CORRECTED else start)
        if rung is Rung.LINEAR:
            return rungs.of_linear(bases, linear)
        if rung is Rung.CORRECTED:
            born, g = rungs.corrected(bases, start, linear)
            return rungs.of_linear(bases, born, g, linear)
        return rungs.nonlinear(stretch, start, linear)

    def _chosen(self, stretch: Stretch) -> tuple[Rung, float, Correction, FloatArray]:
        """The cheapest rung that keeps the tolerance, its estimated error, its answer, and what
        the next one says of the state at the end.
        """
        rungs, better = self._rungs, self._better
        bases = rungs.bases(stretch, self._grid.spacing)
        linear = rungs.linear(bases, self._d)
        born, g = rungs.corrected(bases, better, linear)
        first = difference(born, linear)
        peaks = self._errors.peaks(bases, born)
        estimate = self._errors.share(first, peaks)
        if estimate <= self.tolerance:
            return Rung.LINEAR, estimate, rungs.of_linear(bases, linear), born.nodes[:, -1].copy()
        if np.any(better != self._d):
            linear = rungs.linear(bases, better)
            born, g = rungs.corrected(bases, better, linear)
        second, _ = rungs.corrected(bases, better, born)
        then = difference(second, born)
        estimate = self._errors.share(then, peaks)
        if estimate <= self.tolerance:
            found = rungs.of_linear(bases, born, g, linear)
            return Rung.CORRECTED, estimate, found, second.nodes[:, -1].copy()
        # A series that shrinks begins Newton's method well; one that grows begins it badly.
        guess = second if then.displacement < 0.5 * first.displacement else linear
        found = rungs.nonlinear(stretch, better, guess)
        return Rung.NONLINEAR, _NONLINEAR_ERROR, found, found.end

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


def _extended(stretch: Stretch, samples: int, period_s: float) -> Stretch:
    """So many samples after the first, going on evenly where there are none yet."""
    ahead = np.arange(1, samples + 2 - len(stretch.volts))
    time_s = period_s * ahead
    w, (before, a) = stretch.velocity_m_s[-1], stretch.acceleration_m_s2[-2:]
    change = (a - before) / period_s
    on = (
        0.0 * time_s,
        w * time_s + a * time_s**2 / 2.0 + change * time_s**3 / 6.0,
        a * time_s + change * time_s**2 / 2.0,
        (stretch.current_a[-1] - stretch.current_a[-2]) * ahead,
        (a - before) * ahead,
    )
    return Stretch(
        *(
            np.concatenate([known, known[-1] + more])
            for known, more in zip(vars(stretch).values(), on, strict=True)
        )
    )

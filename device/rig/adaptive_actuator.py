"""An actuator that models only what a scene needs: each block gets the cheapest sufficient model.

The linear model moves every block first. Its response to the force and voltage that it neglects
(the Born term) estimates its error. Beyond the tolerance, the non-linear model moves the block
again. Each model begins with the excursion, speed and current at which the last one ended.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from device import blocks
from device.errors import UsageError
from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION, Motion
from device.rig.co_energy import energies
from device.rig.equations import Equations
from device.rig.model_design import STATE_NUMBERS, ModelDesign
from device.rig.parameters import MODELS, Model, check_tolerance
from device.rig.rig import Rig
from device.units import FloatArray, finite_or_zero

BLOCK_S = 0.1
_ABSURD_V = 1e6
_REPORTS = 4_096
_NAMES = (*QUANTITIES, SEAT_ACCELERATION)


@dataclass(frozen=True)
class BlockReport:
    """How one block, or as much of one as a call brought, was computed."""

    frame: int  # number of its first frame since the start
    frames: int
    model: Model  # "linear" or "nonlinear"
    estimate: float  # error of the linear model as a share of the peak, where it was estimated


class AdaptiveActuator:
    """One actuator with both models; it keeps its state between blocks. One thread calls it.

    Between samples the voltage is a straight line, and it was 0 before the first. With one model,
    the bytes do not depend on how the signal is split. "auto" chooses for each block of 0.1 s since
    the start, or for as much of it as a call brings.

    tolerance: allowed error of excursion and acceleration as a share of a block's peak, above 0 and
    at most 1. model: use this one, whatever its error. seat: the actuator is on the rig's seat
    instead of solid ground. refine: halve the steps of the non-linear model so often, which divides
    their error by 16 each time.

    UsageError: the rig has no seat, a number is out of range, or the library is missing.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: float,
        tolerance: float = 1e-3,
        *,
        model: Model = "auto",
        seat: bool = False,
        refine: int = 0,
    ) -> None:
        check_tolerance(tolerance)
        if not (np.isfinite(samplerate) and samplerate > 0):
            raise UsageError(f"samplerate={samplerate!r} Hz must be above 0; choose another rate")
        if seat and rig.seat is None:
            raise UsageError(f"rig {rig.name!r} describes no [seat]; add it to its file")
        if blocks.compiled is None:
            raise UsageError(
                "the simulated rig needs device/blocks_library.so, which is missing or damaged; "
                "install a C compiler and then this package again"
            )
        if rig.large_signal is None:
            model = "linear"  # it leaves nothing out
        self.rig, self.samplerate, self.tolerance, self.model = rig, samplerate, tolerance, model
        self._move = blocks.compiled.move_rig
        source_ohm, frame = rig.amplifier.source_impedance_ohm, rig.seat if seat else None
        stored = energies(rig.actuator, rig.large_signal)
        equations = Equations(rig.actuator, stored, source_ohm, frame)
        self._design = ModelDesign(equations, samplerate, tolerance, refine)
        self._rows = 5 if seat else 4
        coarse = self._design.coarse
        self.block_frames = coarse * max(1, round(BLOCK_S * samplerate / coarse))
        self.reset()

    def reset(self) -> None:
        """Come to rest, and clear reports and counts."""
        self._state = np.zeros(STATE_NUMBERS)
        self._frames = 0
        self.replaced_samples = 0  # volts that were not finite or above 1e6 and became 0
        self.reports: deque[BlockReport] = deque(maxlen=_REPORTS)
        self.frames_by_model: dict[Model, int] = {"linear": 0, "nonlinear": 0}

    @property
    def unresolved_frames(self) -> int:
        """Frames so far in which a stop was harder than the shortest step can follow."""
        return int(self._state[-1])

    def move(self, volts: FloatArray, outputs: Sequence[str] = QUANTITIES) -> Motion:
        """Return the motion under the amplifier's next open-circuit volts, (frames,).

        It is always finite. Of the `outputs`, seat_acceleration_m_s2 needs a seat.
        """
        finite = np.ascontiguousarray(volts, dtype=np.float64)
        if not blocks.peak(finite) <= _ABSURD_V:  # NaN as well
            finite, replaced = finite_or_zero(finite, _ABSURD_V)
            self.replaced_samples += replaced
        moved = np.empty((self._rows, len(finite)))
        if len(finite):
            self._move_into(finite, moved)
        rows = dict(zip(_NAMES, moved, strict=False))
        return Motion(**{name: rows[name] for name in outputs})

    def _move_into(self, volts: FloatArray, moved: FloatArray) -> None:
        whole, block = len(volts), self.block_frames
        first = min(block - self._frames % block, whole)
        lengths = [first, *(min(block, whole - start) for start in range(first, whole, block))]
        found = np.zeros((len(lengths), 2))
        numbers = 0, whole, first, block, MODELS.index(self.model)
        self._move(volts, moved, self._design.arrays, self._state, found, numbers)
        for frames, (nonlinear, estimate) in zip(lengths, found.tolist(), strict=True):
            model: Model = "nonlinear" if nonlinear else "linear"
            self.reports.append(BlockReport(self._frames, frames, model, estimate))
            self.frames_by_model[model] += frames
            self._frames += frames

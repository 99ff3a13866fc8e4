"""Which level a block needs: the cheapest whose estimated error stays inside the tolerance.

The error of the linear level is estimated by 1.5 times the Born term, that of the Born term by 1.5
times what a second one would change (error_estimate.py). Both begin with the best that is known
of the state, so what cheap levels of earlier blocks have left ringing is in the estimate.

Where blocks that swung no further were beyond all cheap levels, the estimate is left out and the
non-linear level taken at once, for several such blocks together. It is the dearest, so this may
cost a little and never accuracy; now and then the estimate is made nonetheless.
"""

import math
from typing import NamedTuple

import numpy as np

from device.rig.collocation import Bases, Linear
from device.rig.equations import EXCURSION, SPEED
from device.rig.model_levels import ModelLevel, ModelLevels
from device.rig.parameters import ActuatorParameters
from device.rig.segment import Correction, Segment
from device.units import FloatArray

MARGIN = 1.5
"""The Born term times this estimates the error of what is without it."""
FLOOR = 0.01
"""Errors are shares of a block's peak, or of this share of Xmax where it moves less."""
ALL = slice(None)


class Errors(NamedTuple):
    """Errors, or peaks, of excursion, m, and acceleration, m/s^2."""

    displacement: float
    acceleration: float


class ErrorEstimate:
    """Estimates of one actuator's errors, from changes that a better level would make."""

    def __init__(self, actuator: ActuatorParameters) -> None:
        floor_m = FLOOR * actuator.x_max_m
        self._floors = Errors(floor_m, floor_m * actuator.resonance_rad_s**2)

    def share(self, change: Errors, peaks: Errors) -> float:
        """The estimate: the larger share of its peak, with the margin; infinite if not finite."""
        largest = max(error / peak for error, peak in zip(change, peaks, strict=True))
        return MARGIN * largest if math.isfinite(largest) else math.inf

    def peaks(self, bases: Bases, path: Linear, nodes: slice = ALL) -> Errors:
        """Of the motion at some nodes, not below the floor."""
        y = np.abs(bases[0].excursion_m[nodes] + path.nodes[EXCURSION, nodes]).max()
        a = np.abs(bases[0].acceleration_m_s2[nodes] + path.node_rates[SPEED, nodes]).max()
        pairs = zip((float(y), float(a)), self._floors, strict=True)
        return Errors(*(max(peak, floor) for peak, floor in pairs))


def difference(one: Linear, other: Linear, nodes: slice = ALL) -> Errors:
    """The largest differences of two paths at some nodes."""
    y = np.abs(one.nodes[EXCURSION, nodes] - other.nodes[EXCURSION, nodes]).max()
    a = np.abs(one.node_rates[SPEED, nodes] - other.node_rates[SPEED, nodes]).max()
    return Errors(float(y), float(a))


_NONLINEAR_ERROR = 1e-6
"""Of the non-linear level, as a share of the peak: it is carried, too."""


_BEYOND = 3.0
"""A correction's estimated error, over the tolerance, from which on a block is beyond it."""
_NO_LESS = 0.7
"""Blocks that swing so much of one that is beyond are taken to be so too: the error of a
correction goes with the square of the level."""
_MORE = 1.2
"""Where one of them turns out not to be, those are that swing so much more than it."""
_TOGETHER = 6
"""Blocks of the non-linear level at once: longer ones save nothing more."""
_LONGEST_SURE = 16
"""Blocks from one estimate to the next."""


class Chosen(NamedTuple):
    """A level for a block, its estimated error, its answer, and what the next one says of d at the
    end, (states,).

    above: the next one's answer, from the better state on, None if it was not computed.
    """

    level: ModelLevel
    estimate: float
    found: Correction
    better: FloatArray
    above: Correction | None = None


class Quiet(NamedTuple):
    """What is estimated of blocks that are linear enough, and the better d at the last one's end.

    estimates: errors; peaks_m: of the excursion; both one a block.
    """

    estimates: list[float]
    peaks_m: list[float]
    better: FloatArray


class ModelSelector:
    """Chooses among one actuator's levels for a tolerance. One thread uses an object.

    early: whether blocks that are surely beyond all cheap levels go without an estimate.
    """

    def __init__(self, levels: ModelLevels, tolerance: float, early: bool = True) -> None:
        self.tolerance, self.early = tolerance, early
        self._levels = levels
        self._errors = ErrorEstimate(levels.equations.actuator)
        self.reset()

    def reset(self) -> None:
        """Forget what blocks were like."""
        self._beyond_m = math.inf
        self._sure_for = 1
        self._left = 0

    def sure(self, segment: Segment, block_nodes: int) -> int:
        """How many of several blocks, from the first on, only the non-linear level can do."""
        if not (self.early and self._left):
            return 0
        blocks = (len(segment.volts) - 1) // (block_nodes * self._levels.spacing)
        found = 0
        for block in range(min(blocks, self._left, _TOGETHER)):
            first = block * block_nodes * self._levels.spacing
            last = first + block_nodes * self._levels.spacing
            if self._swing_m(segment.part(first, last)) < self._beyond_m:
                break
            found += 1
        self._left -= found
        return found

    def dearest(self, segment: Segment, better: FloatArray) -> Chosen:
        """The non-linear level without an estimate."""
        found = self._levels.answer(ModelLevel.NONLINEAR, segment, better, better)
        return Chosen(ModelLevel.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

    def _swing_m(self, segment: Segment) -> float:
        return float(np.abs(segment.displacement_m[:: self._levels.spacing]).max())

    def _learn(self, segment: Segment, beyond: bool) -> None:
        """Take notice of an estimate that was made."""
        swing_m = self._swing_m(segment)
        if beyond:
            if swing_m >= self._beyond_m:
                self._sure_for = min(2 * self._sure_for, _LONGEST_SURE)
            self._beyond_m = min(self._beyond_m, _NO_LESS * swing_m)
        elif swing_m >= self._beyond_m:
            self._beyond_m, self._sure_for = _MORE * swing_m, 1
        self._left = self._sure_for

    def quiet(
        self, segment: Segment, start: FloatArray, better: FloatArray, block_nodes: int
    ) -> Quiet:
        """Of several blocks, the first ones that are linear enough.

        One estimate for all of them is cheaper, and what earlier ones leave is in it.
        """
        bases = self._levels.bases(segment, self._levels.spacing)
        linear = self._levels.linear(bases, start)
        born, _ = self._levels.corrected(bases, better, linear)
        estimates: list[float] = []
        peaks_m: list[float] = []
        for first in range(0, len(bases[0].excursion_m) - 1, block_nodes):
            nodes = slice(first, first + block_nodes + 1)
            change = difference(born, linear, nodes)
            estimate = self._errors.share(change, self._errors.peaks(bases, born, nodes))
            if estimate > self.tolerance:
                break
            estimates.append(estimate)
            excursion_m = bases[0].excursion_m[nodes] + linear.nodes[0, nodes]
            peaks_m.append(float(np.abs(excursion_m).max()))
        end = born.nodes[:, len(estimates) * block_nodes].copy()
        return Quiet(estimates, peaks_m, end)

    def one(self, segment: Segment, start: FloatArray, better: FloatArray) -> Chosen:
        """For one block.

        start: d at its first node as it was shown so far; better: as the level above knows it.
        """
        levels = self._levels
        bases = levels.bases(segment, levels.spacing)
        linear = levels.linear(bases, start)
        born, g = levels.corrected(bases, better, linear)
        first = difference(born, linear)
        peaks = self._errors.peaks(bases, born)
        estimate = self._errors.share(first, peaks)
        if estimate <= self.tolerance:
            self._learn(segment, beyond=False)
            found, above = levels.of_linear(bases, linear), levels.of_linear(bases, born, g, linear)
            return Chosen(ModelLevel.LINEAR, estimate, found, above.end, above)
        if np.any(better != start):
            linear = levels.linear(bases, better)
            born, g = levels.corrected(bases, better, linear)
        second, then_g = levels.corrected(bases, better, born)
        then = difference(second, born)
        estimate = self._errors.share(then, peaks)
        self._learn(segment, estimate > _BEYOND * self.tolerance)
        if estimate <= self.tolerance:
            found = levels.of_linear(bases, born, g, linear)
            above = levels.of_linear(bases, second, then_g, born)
            return Chosen(ModelLevel.CORRECTED, estimate, found, above.end, above)
        # A series that shrinks begins Newton's method well; one that grows begins it badly.
        guess = second if then.displacement < 0.5 * first.displacement else linear
        found = levels.nonlinear(segment, better, guess)
        return Chosen(ModelLevel.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

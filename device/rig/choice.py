"""Which rung a block needs: the cheapest whose estimated error stays inside the tolerance.

The error of the linear rung is estimated by 1.5 times the Born term, that of the Born term by 1.5
times what a second one would change (error_estimate.py). Both begin with the best that is known
of the state, so what cheap rungs of earlier blocks have left ringing is in the estimate.

Where blocks that swung no further were beyond all cheap rungs, the estimate is left out and the
non-linear rung taken at once, for several such blocks together. It is the dearest, so this may
cost a little and never accuracy; now and then the estimate is made nonetheless.
"""

import math
from typing import NamedTuple

import numpy as np

from device.rig.correction import Correction
from device.rig.error_estimate import ErrorEstimate, difference
from device.rig.rungs import Rung, Rungs
from device.rig.stretch import Stretch
from device.units import FloatArray

_NONLINEAR_ERROR = 1e-6
"""Of the non-linear rung, as a share of the peak: it is carried, too."""


_BEYOND = 3.0
"""A correction's estimated error, over the tolerance, from which on a block is beyond it."""
_NO_LESS = 0.7
"""Blocks that swing so much of one that is beyond are taken to be so too: the error of a
correction goes with the square of the level."""
_MORE = 1.2
"""Where one of them turns out not to be, those are that swing so much more than it."""
_TOGETHER = 6
"""Blocks of the non-linear rung at once: longer ones save nothing more."""
_LONGEST_SURE = 16
"""Blocks from one estimate to the next."""


class Chosen(NamedTuple):
    """A rung for a block, its estimated error, its answer, and what the next one says of d at the
    end, (states,).

    above: the next one's answer, from the better state on, None if it was not computed.
    """

    rung: Rung
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


class Choice:
    """Chooses among one actuator's rungs for a tolerance. One thread uses an object.

    early: whether blocks that are surely beyond all cheap rungs go without an estimate.
    """

    def __init__(self, rungs: Rungs, tolerance: float, early: bool = True) -> None:
        self.tolerance, self.early = tolerance, early
        self._rungs = rungs
        self._errors = ErrorEstimate(rungs.equations.actuator)
        self.reset()

    def reset(self) -> None:
        """Forget what blocks were like."""
        self._beyond_m = math.inf
        self._sure_for = 1
        self._left = 0

    def sure(self, stretch: Stretch, block_nodes: int) -> int:
        """How many of several blocks, from the first on, only the non-linear rung can do."""
        if not (self.early and self._left):
            return 0
        blocks = (len(stretch.volts) - 1) // (block_nodes * self._rungs.spacing)
        found = 0
        for block in range(min(blocks, self._left, _TOGETHER)):
            first = block * block_nodes * self._rungs.spacing
            last = first + block_nodes * self._rungs.spacing
            if self._swing_m(stretch.part(first, last)) < self._beyond_m:
                break
            found += 1
        self._left -= found
        return found

    def dearest(self, stretch: Stretch, better: FloatArray) -> Chosen:
        """The non-linear rung without an estimate."""
        found = self._rungs.answer(Rung.NONLINEAR, stretch, better, better)
        return Chosen(Rung.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

    def _swing_m(self, stretch: Stretch) -> float:
        return float(np.abs(stretch.displacement_m[:: self._rungs.spacing]).max())

    def _learn(self, stretch: Stretch, beyond: bool) -> None:
        """Take notice of an estimate that was made."""
        swing_m = self._swing_m(stretch)
        if beyond:
            if swing_m >= self._beyond_m:
                self._sure_for = min(2 * self._sure_for, _LONGEST_SURE)
            self._beyond_m = min(self._beyond_m, _NO_LESS * swing_m)
        elif swing_m >= self._beyond_m:
            self._beyond_m, self._sure_for = _MORE * swing_m, 1
        self._left = self._sure_for

    def quiet(
        self, stretch: Stretch, start: FloatArray, better: FloatArray, block_nodes: int
    ) -> Quiet:
        """Of several blocks, the first ones that are linear enough.

        One estimate for all of them is cheaper, and what earlier ones leave is in it.
        """
        bases = self._rungs.bases(stretch, self._rungs.spacing)
        linear = self._rungs.linear(bases, start)
        born, _ = self._rungs.corrected(bases, better, linear)
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

    def one(self, stretch: Stretch, start: FloatArray, better: FloatArray) -> Chosen:
        """For one block.

        start: d at its first node as it was shown so far; better: as the rung above knows it.
        """
        rungs = self._rungs
        bases = rungs.bases(stretch, rungs.spacing)
        linear = rungs.linear(bases, start)
        born, g = rungs.corrected(bases, better, linear)
        first = difference(born, linear)
        peaks = self._errors.peaks(bases, born)
        estimate = self._errors.share(first, peaks)
        if estimate <= self.tolerance:
            self._learn(stretch, beyond=False)
            found, above = rungs.of_linear(bases, linear), rungs.of_linear(bases, born, g, linear)
            return Chosen(Rung.LINEAR, estimate, found, above.end, above)
        if np.any(better != start):
            linear = rungs.linear(bases, better)
            born, g = rungs.corrected(bases, better, linear)
        second, then_g = rungs.corrected(bases, better, born)
        then = difference(second, born)
        estimate = self._errors.share(then, peaks)
        self._learn(stretch, estimate > _BEYOND * self.tolerance)
        if estimate <= self.tolerance:
            found = rungs.of_linear(bases, born, g, linear)
            above = rungs.of_linear(bases, second, then_g, born)
            return Chosen(Rung.CORRECTED, estimate, found, above.end, above)
        # A series that shrinks begins Newton's method well; one that grows begins it badly.
        guess = second if then.displacement < 0.5 * first.displacement else linear
        found = rungs.nonlinear(stretch, better, guess)
        return Chosen(Rung.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

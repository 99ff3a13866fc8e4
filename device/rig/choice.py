"""Which rung a block needs: the cheapest whose estimated error stays inside the tolerance.

The error of the linear rung is estimated by 1.5 times the Born term, that of the Born term by 1.5
times what a second one would change (error_estimate.py). Both begin with the best that is known
of the state, so what cheap rungs of earlier blocks have left ringing is in the estimate.
"""

from typing import NamedTuple

import numpy as np

from device.rig.correction import Correction
from device.rig.error_estimate import ErrorEstimate, difference
from device.rig.rungs import Rung, Rungs
from device.rig.stretch import Stretch
from device.units import FloatArray

_NONLINEAR_ERROR = 1e-6
"""Of the non-linear rung, as a share of the peak: it is carried, too."""


class Chosen(NamedTuple):
    """A rung for a block, its estimated error, its answer, and what the next one says of d at the
    end, (states,).
    """

    rung: Rung
    estimate: float
    found: Correction
    better: FloatArray


class Quiet(NamedTuple):
    """What is estimated of blocks that are linear enough, and the better d at the last one's end.

    estimates: errors; peaks_m: of the excursion; both one a block.
    """

    estimates: list[float]
    peaks_m: list[float]
    better: FloatArray


class Choice:
    """Chooses among one actuator's rungs for a tolerance. One thread uses an object."""

    def __init__(self, rungs: Rungs, tolerance: float) -> None:
        self.tolerance = tolerance
        self._rungs = rungs
        self._errors = ErrorEstimate(rungs.equations.actuator)

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
            end = born.nodes[:, -1].copy()
            return Chosen(Rung.LINEAR, estimate, rungs.of_linear(bases, linear), end)
        if np.any(better != start):
            linear = rungs.linear(bases, better)
            born, g = rungs.corrected(bases, better, linear)
        second, _ = rungs.corrected(bases, better, born)
        then = difference(second, born)
        estimate = self._errors.share(then, peaks)
        if estimate <= self.tolerance:
            found = rungs.of_linear(bases, born, g, linear)
            return Chosen(Rung.CORRECTED, estimate, found, second.nodes[:, -1].copy())
        # A series that shrinks begins Newton's method well; one that grows begins it badly.
        guess = second if then.displacement < 0.5 * first.displacement else linear
        found = rungs.nonlinear(stretch, better, guess)
        return Chosen(Rung.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

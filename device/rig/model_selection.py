"""Which model a block needs: the cheapest whose estimated error stays inside the tolerance.

The estimate of the linear model's error is 1.5 times the Born term. That of the Born term is 1.5
times the change by a second one. Both begin with the best known state, so the estimate includes
what cheap models of earlier blocks left ringing.

If blocks with no larger excursion exceeded the tolerance with all cheap models, the non-linear
model is used without an estimate, for several such blocks together. Now and then it is made anyway.
"""

import math
from typing import NamedTuple

import numpy as np

from device.rig.collocation import Bases, Linear
from device.rig.equations import EXCURSION, SPEED
from device.rig.model_levels import ModelLevel, ModelLevels
from device.rig.segment import Correction, Segment
from device.units import FloatArray

MARGIN = 1.5
"""The Born term times this estimates the error without it."""
FLOOR = 0.01
"""Errors are shares of a block's peak, or of this share of Xmax if the block moves less."""
ALL = slice(None)

_NONLINEAR_ERROR = 1e-6
"""Assumed error of the non-linear model, as a share of the peak."""
_BEYOND = 3.0
"""A block is beyond a correction if the estimated error exceeds the tolerance by this factor."""
_BEYOND_SHARE = 0.7
"""Blocks with this share of such a block's excursion are assumed to be beyond it as well."""
_RAISE = 1.2
"""If one of them is not, the assumption is raised to this multiple of its excursion."""
_MAX_TOGETHER = 6
"""Most non-linear blocks solved together; more of them save nothing."""
_MAX_SURE = 16
"""Largest number of blocks from one estimate to the next."""


class Errors(NamedTuple):
    """Errors, or peaks, of excursion, m, and acceleration, m/s^2."""

    displacement: float
    acceleration: float


def share_of_peak(change: Errors, peaks: Errors) -> float:
    """Return the larger share of its peak, with the margin; infinity if it is not finite."""
    largest = max(error / peak for error, peak in zip(change, peaks, strict=True))
    return MARGIN * largest if math.isfinite(largest) else math.inf


def largest_difference(one: Linear, other: Linear, nodes: slice = ALL) -> Errors:
    """Return the largest differences of two paths at some nodes."""
    y = np.abs(one.nodes[EXCURSION, nodes] - other.nodes[EXCURSION, nodes]).max()
    a = np.abs(one.node_rates[SPEED, nodes] - other.node_rates[SPEED, nodes]).max()
    return Errors(float(y), float(a))


class SelectedModel(NamedTuple):
    """The model for one block, and its result."""

    level: ModelLevel
    estimate: float  # of its error
    correction: Correction
    better: FloatArray  # d at the end by the next better model, (states,)
    above: Correction | None = None  # of the next better model, if it was computed


class LinearBlocks(NamedTuple):
    """Consecutive blocks for which the linear model suffices."""

    estimates: list[float]  # of the error of each block
    peaks_m: list[float]  # the excursion of each block
    better: FloatArray  # as in `SelectedModel`


class ModelSelector:
    """Selects among one actuator's models for a tolerance. One thread uses an object.

    With `early`, blocks that surely need the non-linear model get no estimate.
    """

    def __init__(self, levels: ModelLevels, tolerance: float, early: bool = True) -> None:
        self.tolerance, self.early = tolerance, early
        self._levels = levels
        actuator = levels.equations.actuator
        floor_m = FLOOR * actuator.x_max_m
        self._floors = Errors(floor_m, floor_m * actuator.resonance_rad_s**2)
        self.reset()

    def reset(self) -> None:
        """Forget which models earlier blocks needed."""
        self._beyond_m = math.inf
        self._sure_for = 1
        self._left = 0

    def count_nonlinear(self, segment: Segment, block_nodes: int) -> int:
        """Return how many of the first blocks surely need the non-linear model."""
        if not (self.early and self._left):
            return 0
        frames = block_nodes * self._levels.spacing
        blocks = (len(segment.volts) - 1) // frames
        found = 0
        for block in range(min(blocks, self._left, _MAX_TOGETHER)):
            part = segment.part(block * frames, (block + 1) * frames)
            if self._excursion_m(part) < self._beyond_m:
                break
            found += 1
        self._left -= found
        return found

    def solve_nonlinear(self, segment: Segment, better: FloatArray) -> SelectedModel:
        """Use the non-linear model without an estimate."""
        found = self._levels.solve(ModelLevel.NONLINEAR, segment, better, better)
        return SelectedModel(ModelLevel.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

    def _peaks(self, bases: Bases, path: Linear, nodes: slice = ALL) -> Errors:
        """Return the peaks of the motion at some nodes, at least the floor."""
        y = np.abs(bases[0].excursion_m[nodes] + path.nodes[EXCURSION, nodes]).max()
        a = np.abs(bases[0].acceleration_m_s2[nodes] + path.node_rates[SPEED, nodes]).max()
        return Errors(max(float(y), self._floors[0]), max(float(a), self._floors[1]))

    def _excursion_m(self, segment: Segment) -> float:
        return float(np.abs(segment.displacement_m[:: self._levels.spacing]).max())

    def _learn(self, segment: Segment, beyond: bool) -> None:
        """Update the excursion from which on blocks are assumed to be beyond cheap models."""
        excursion_m = self._excursion_m(segment)
        if beyond:
            if excursion_m >= self._beyond_m:
                self._sure_for = min(2 * self._sure_for, _MAX_SURE)
            self._beyond_m = min(self._beyond_m, _BEYOND_SHARE * excursion_m)
        elif excursion_m >= self._beyond_m:
            self._beyond_m, self._sure_for = _RAISE * excursion_m, 1
        self._left = self._sure_for

    def find_linear(
        self, segment: Segment, start: FloatArray, better: FloatArray, block_nodes: int
    ) -> LinearBlocks:
        """Return the first of several blocks for which the linear model suffices.

        One estimate for all of them is cheaper and includes what earlier blocks left ringing.
        """
        bases = self._levels.base_solutions(segment, self._levels.spacing)
        linear = self._levels.solve_linear(bases, start)
        born, _ = self._levels.solve_born(bases, better, linear)
        estimates: list[float] = []
        peaks_m: list[float] = []
        for first in range(0, len(bases[0].excursion_m) - 1, block_nodes):
            nodes = slice(first, first + block_nodes + 1)
            change = largest_difference(born, linear, nodes)
            estimate = share_of_peak(change, self._peaks(bases, born, nodes))
            if estimate > self.tolerance:
                break
            estimates.append(estimate)
            excursion_m = bases[0].excursion_m[nodes] + linear.nodes[0, nodes]
            peaks_m.append(float(np.abs(excursion_m).max()))
        end = born.nodes[:, len(estimates) * block_nodes].copy()
        return LinearBlocks(estimates, peaks_m, end)

    def select(self, segment: Segment, start: FloatArray, better: FloatArray) -> SelectedModel:
        """Select the model of a block from d at its first node, by the present and a better one."""
        levels = self._levels
        bases = levels.base_solutions(segment, levels.spacing)
        linear = levels.solve_linear(bases, start)
        born, g = levels.solve_born(bases, better, linear)
        first = largest_difference(born, linear)
        peaks = self._peaks(bases, born)
        estimate = share_of_peak(first, peaks)
        if estimate <= self.tolerance:
            self._learn(segment, beyond=False)
            found = levels.correct_by(bases, linear)
            above = levels.correct_by(bases, born, g, linear)
            return SelectedModel(ModelLevel.LINEAR, estimate, found, above.end, above)
        if np.any(better != start):
            linear = levels.solve_linear(bases, better)
            born, g = levels.solve_born(bases, better, linear)
        second, then_g = levels.solve_born(bases, better, born)
        then = largest_difference(second, born)
        estimate = share_of_peak(then, peaks)
        self._learn(segment, estimate > _BEYOND * self.tolerance)
        if estimate <= self.tolerance:
            found = levels.correct_by(bases, born, g, linear)
            above = levels.correct_by(bases, second, then_g, born)
            return SelectedModel(ModelLevel.CORRECTED, estimate, found, above.end, above)
        # A converging series is a good start for Newton's method, a diverging one a bad start.
        guess = second if then.displacement < 0.5 * first.displacement else linear
        found = levels.solve_nonlinear(segment, better, guess)
        return SelectedModel(ModelLevel.NONLINEAR, _NONLINEAR_ERROR, found, found.end)

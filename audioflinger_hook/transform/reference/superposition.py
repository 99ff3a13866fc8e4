"""Equations (5)-(7): cosines of a unit, added up. In float64, or as float32 at a tenth of the cost.

By cos(a + b) = cos a cos b - sin a sin b a unit becomes a matrix product. Frames that this could
round otherwise than the sum of equation (7) are computed as it says.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray

EPSILON = 2.0**-52

ANGLE_ERROR = 8.0
"""Either sum rounds a frame's time and its angle three times in all, by half an epsilon of the
largest angle at most: together 3 epsilons of it; this is more than twice that."""

TERM_ERROR = 16.0
"""With cosines good to 4 units in the last place, a partial's part of either sum and its addition
are off by 13 epsilons of its weight at most."""


class Superposition:
    """Sums of cosines over the frames of one unit; pure, holds only its times.

    frames: N; samplerate: Hz. Weights are not negative.
    """

    def __init__(self, frames: int, samplerate: int) -> None:
        self._frames = frames
        self._turns = 2.0 * np.pi * np.arange(frames) / samplerate
        self._fine = math.isqrt(frames - 1) + 1
        self._coarse_turns = self._turns[:: self._fine]
        self._fine_turns = self._turns[: self._fine]

    def exact(self, weight: FloatArray, hz: FloatArray) -> FloatArray:
        """Return the sum of weight cos(2 pi hz t), (N,), the partials (partials,) in their order.

        t: seconds from the unit's own start.
        """
        unit = np.zeros(self._frames)
        for partial in range(len(weight)):
            unit += weight[partial] * np.cos(hz[partial] * self._turns)
        return unit

    def single(self, weight: FloatArray, hz: FloatArray, edges: IntArray) -> FloatArray:
        """Return the same of several units, (units, N), such that float32 of it is that of `exact`.

        weight, hz: the partials of all units, one after another; unit i has those from edges[i]
        up to edges[i + 1].
        """
        grid = np.zeros((len(edges) - 1, self._coarse_turns.size, self._fine))
        coarse, fine = np.multiply.outer(hz, self._coarse_turns), hz[:, None] * self._fine_turns
        # Weighted cosines over sines, and cosines over negative sines: a product of matrices.
        left = np.stack((np.cos(coarse), np.sin(coarse)), axis=1) * weight[:, None, None]
        right = np.stack((np.cos(fine), -np.sin(fine)), axis=1)
        for unit, (first, end) in enumerate(pairwise(edges)):
            if first < end:
                rows = left[first:end].reshape(-1, self._coarse_turns.size)
                columns = right[first:end].reshape(-1, self._fine)
                np.matmul(rows.T, columns, out=grid[unit])
        sums = grid.reshape(len(grid), -1)
        if weight.size:
            self._settle(sums, weight, hz, edges)
        return sums[:, : self._frames]

    def _settle(
        self, sums: FloatArray, weight: FloatArray, hz: FloatArray, edges: IntArray
    ) -> None:
        """Replace every sum so near to an edge of float32 that its error could carry it over."""
        counts = np.diff(edges)
        totals = np.add.reduceat(np.append(weight, 0.0), edges[:-1]) * (counts > 0)
        epsilons = ANGLE_ERROR * float(hz.max() * self._turns[-1])
        epsilons += TERM_ERROR * (float(counts.max()) + 1.0)
        error = (epsilons * EPSILON) * totals[:, None]
        shifted = sums - error
        lower = shifted.astype(np.float32)
        np.add(sums, error, out=shifted)
        unsure = np.flatnonzero(lower != shifted.astype(np.float32))
        for unit, frame in zip(*np.divmod(unsure, sums.shape[1]), strict=True):
            if frame < self._frames:
                mine = slice(edges[unit], edges[unit + 1])
                total = 0.0
                for term in weight[mine] * np.cos(hz[mine] * self._turns[frame]):
                    total += term  # in the order of `exact`
                sums[unit, frame] = total

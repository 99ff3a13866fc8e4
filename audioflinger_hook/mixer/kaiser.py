"""The resampler's filter: a windowed sinc, stored for block products or for interpolation.

J. F. Kaiser, Nonrecursive digital filter design using the I0-sinh window function, ISCAS 1974; for
the interpolated form J. O. Smith and P. Gossett, A flexible sampling-rate conversion method, 1984.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

HALF_WIDTH = 64  # half of the filter's length, in frames of the lower of the two rates
# The pass band's end as a part of the lower rate's Nyquist; the stop band starts at 1.
PASS_EDGE = 0.9
STOP_BAND_DB = 98.0  # attenuation of the Kaiser window, dB: by Kaiser's formula 127 taps reach it
# Up to this many phases, each has its own row of coefficients; beyond, rows are interpolated.
PHASES_EXACT = 1024

ROWS_AT_ONCE = 128
BLOCK_FLOATS = 1 << 15
FLOATS_AT_MOST = 1 << 21
"""Limits of the block matrices: output frames in one; rows x taps in one, so that OpenBLAS starts
no threads for a stereo block; float32 values in all of them (8 MB)."""


@dataclass(frozen=True)
class Ratio:
    """The ratio of two rates in lowest terms, and the filter that the conversion needs."""

    up: int  # output frames to `down` input frames
    down: int
    taps: int  # input frames under the filter, even

    @classmethod
    def of(cls, rate_in: int, rate_out: int) -> Ratio:
        """The ratio of two rates in Hz."""
        common = int(np.gcd(rate_in, rate_out))
        up, down = rate_out // common, rate_in // common
        return cls(up, down, 2 * -(-HALF_WIDTH * max(up, down) // up))

    @property
    def is_exact(self) -> bool:
        """Whether each phase has its own row of coefficients, within the memory allowed."""
        return self.up <= PHASES_EXACT and 2 * self.up * self.taps <= FLOATS_AT_MOST

    def coefficients(self, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """The filter for outputs `offset` (0 to 1) input frames after an input frame: rows of taps.

        The last tap belongs to that input frame. Each row sums to 1, so a constant stays constant.
        """
        distance = offset[:, None] + np.arange(self.taps // 2 - 1, -self.taps // 2 - 1, -1)
        lowered = min(1.0, self.up / self.down)
        cutoff = lowered * (1.0 + PASS_EDGE) / 2.0
        beta = 0.1102 * (STOP_BAND_DB - 8.7)
        inside = 1.0 - (distance * lowered / HALF_WIDTH) ** 2
        window = np.where(inside >= 0.0, np.i0(beta * np.sqrt(np.maximum(inside, 0.0))), 0.0)
        rows = np.sinc(cutoff * distance) * window
        return np.asarray(rows / rows.sum(axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class BlockMatrices:
    """The filter of an exact ratio as products of one shape.

    Outputs are cut into periods of `period_out` frames (`period_in` input frames), and periods into
    blocks of `rows`. Block b is `matrices[b] @ inputs`; its inputs begin at `offsets[b] - taps + 1`
    after the period's start. matrices: (blocks, rows, columns) float32. The last block of a period
    may have rows of zeros at its end.
    """

    matrices: NDArray[np.float32]
    offsets: tuple[int, ...]
    rows: int
    period_out: int
    period_in: int


@lru_cache(maxsize=16)
def block_matrices(ratio: Ratio) -> BlockMatrices:
    """The block matrices of an exact ratio. Tracks of one ratio share them: do not change them.

    A product of fixed shape adds in a fixed order, and the grid of blocks depends only on the
    stream. So the output does not depend on how the stream is split.
    """
    up, down, taps = ratio.up, ratio.down, ratio.taps
    rows_at_once = max(1, min(ROWS_AT_ONCE, BLOCK_FLOATS // taps))
    repeats = max(1, rows_at_once // up)
    period = up * repeats
    blocks = -(-period // rows_at_once)
    rows = -(-period // blocks)
    output = np.arange(period)
    position = output * down // up
    offsets = position[::rows][:blocks]
    columns = taps + max(
        int(position[min(first + rows, period) - 1] - position[first])
        for first in range(0, period, rows)
    )
    by_phase = ratio.coefficients(np.arange(up) / up).astype(np.float32)
    matrices = np.zeros((blocks, rows, columns), np.float32)
    for index in range(period):
        block, row = divmod(index, rows)
        start = int(position[index] - offsets[block])
        matrices[block, row, start : start + taps] = by_phase[index * down % up]
    return BlockMatrices(matrices, tuple(offsets.tolist()), rows, period, down * repeats)


@lru_cache(maxsize=16)
def phase_table(ratio: Ratio) -> NDArray[np.float32]:
    """The filter at evenly spaced offsets from 0 to 1: (phases + 1, taps) float32, shared.

    Between two rows the coefficients are interpolated linearly. With `PHASES_EXACT` rows to a
    frame of the lower rate the error is (pi/1024)^2 / 8, -118 dB.
    """
    phases = max(8, -(-PHASES_EXACT * ratio.up // max(ratio.up, ratio.down)))
    return ratio.coefficients(np.arange(phases + 1) / phases).astype(np.float32)

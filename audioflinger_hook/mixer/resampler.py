"""The resampler: converts a stream's rate; any split into blocks gives the same bits.

The filter is a windowed sinc, stored for block products or for interpolation: J. F. Kaiser,
Nonrecursive digital filter design using the I0-sinh window function, ISCAS 1974; J. O. Smith and
P. Gossett, A flexible sampling-rate conversion method, 1984.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from device.units import Float32Array

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

# Limits of one step of the interpolated form.
OUTPUTS_AT_ONCE, WINDOW_FLOATS_AT_ONCE = 64, 1 << 16


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

    matrices: Float32Array
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
def phase_table(ratio: Ratio) -> Float32Array:
    """The filter at evenly spaced offsets from 0 to 1: (phases + 1, taps) float32, shared.

    Between two rows the coefficients are interpolated linearly. With `PHASES_EXACT` rows to a
    frame of the lower rate the error is (pi/1024)^2 / 8, -118 dB.
    """
    phases = max(8, -(-PHASES_EXACT * ratio.up // max(ratio.up, ratio.down)))
    return ratio.coefficients(np.arange(phases + 1) / phases).astype(np.float32)


class Resampler:
    """A polyphase Kaiser resampler between two rates in Hz.

    Stop band from the lower rate's Nyquist on: 98 dB; pass band to 0.9 of it: ripple 0.001 dB. The
    position is a fraction of integers and never drifts. Any split of the input and of the output
    gives the same bits. Samples that are not finite count as 0.

    One cycle: `frames_needed(n)` says how many frames to `feed`, in any pieces; `produce` then
    fills exactly n. Output frame j lies at input frame j rate_in/rate_out - `latency_frames`.

    max_frames: produced at once; memory grows only if more is fed than needed. Use from one thread.
    """

    def __init__(self, rate_in: int, rate_out: int, channels: int, max_frames: int) -> None:
        self._ratio = Ratio.of(rate_in, rate_out)
        self._kernel: _BlockKernel | _InterpolatingKernel
        if self._ratio.is_exact:
            self._kernel = _BlockKernel(self._ratio, channels)
        else:
            self._kernel = _InterpolatingKernel(self._ratio)
        self.latency_frames = self._ratio.taps // 2
        # this many frames of silence bring out all sound that was fed before
        self.tail_frames = self._ratio.taps
        # behind the fed frames lies memory that a block's zero coefficients may touch
        most_in = -(-max_frames * self._ratio.down // self._ratio.up) + 1
        self._inputs = np.zeros((self._kernel.reach + most_in, channels), np.float32)
        self.reset()

    def reset(self) -> None:
        """Return to the start of a new stream, with silence before it."""
        self._inputs[:] = 0.0
        # inputs[0] is input frame `_base`; frames fed so far; the next output frame
        self._base = -self._ratio.taps
        self._fed = 0
        self._next = 0

    def frames_needed(self, frames_out: int) -> int:
        """How many more input frames are needed to `produce` this many output frames."""
        if frames_out == 0:
            return 0
        last = (self._next + frames_out - 1) * self._ratio.down // self._ratio.up
        return max(0, last + 1 - self._fed)

    def feed(self, frames: Float32Array) -> None:
        """Take the next input frames, (n, channels) float32, any number."""
        room = self._reserve(len(frames))
        room[...] = frames
        # a block's zero coefficients would not silence them
        finite = np.isfinite(room)
        if not finite.all():
            room[~finite] = 0.0

    def produce(self, frames: Float32Array) -> None:
        """Fill `frames`, (n, channels) float32, from the `frames_needed(n)` that were fed."""
        self._kernel.render(self._inputs, self._base, self._next, frames)
        self._next += len(frames)

    def _reserve(self, count: int) -> Float32Array:
        end = self._fed - self._base
        if end + count + self._kernel.slack > len(self._inputs):
            kept = self._kernel.first_input(self._next) - self._base
            self._base += kept
            held = end - kept
            wanted = held + count + self._kernel.slack
            if wanted > len(self._inputs):
                grown = np.zeros((2 * wanted, self._inputs.shape[1]), np.float32)
                grown[:held] = self._inputs[kept:end]
                self._inputs = grown
            else:
                self._inputs[:held] = self._inputs[kept:end]
            end = held
        self._fed += count
        return self._inputs[end : end + count]


def frames_out(frames_in: int, rate_in: int, rate_out: int) -> int:
    """How many output frames can be made from a stream's first `frames_in` input frames."""
    return -(-frames_in * rate_out // rate_in)


def tail_frames_out(rate_in: int, rate_out: int) -> int:
    """How many output frames after a stream's end still carry its sound; 0 at equal rates."""
    if rate_in == rate_out:
        return 0
    return frames_out(Ratio.of(rate_in, rate_out).taps // 2, rate_in, rate_out)


class _BlockKernel:
    """Outputs as matrix products of one shape, on a grid of blocks fixed to the stream's start."""

    def __init__(self, ratio: Ratio, channels: int) -> None:
        self._taps = ratio.taps
        self._blocks: BlockMatrices = block_matrices(ratio)
        columns = self._blocks.matrices.shape[2]
        self._whole = np.zeros((self._blocks.rows, channels), np.float32)
        self.slack = columns
        self.reach = 3 * columns

    def first_input(self, output: int) -> int:
        """The first input frame that is still needed for that output frame and all after it."""
        period, block, _ = self._place(output)
        blocks = self._blocks
        return period * blocks.period_in + blocks.offsets[block] - self._taps + 1

    def render(self, inputs: Float32Array, base: int, first: int, frames: Float32Array) -> None:
        """Fill `frames` with the outputs from `first` on; inputs[0] is input frame `base`."""
        blocks = self._blocks
        columns = self.slack
        done = 0
        while done < len(frames):
            period, block, row = self._place(first + done)
            end_row = min(blocks.rows, blocks.period_out - block * blocks.rows)
            count = min(end_row - row, len(frames) - done)
            start = period * blocks.period_in + blocks.offsets[block] - self._taps + 1 - base
            window = inputs[start : start + columns]
            if count == blocks.rows:
                np.matmul(blocks.matrices[block], window, out=frames[done : done + count])
            else:
                # A part of a block is cut from the whole block. The rows left out may use frames
                # that are not fed yet; the rows of the part have zeros there.
                np.matmul(blocks.matrices[block], window, out=self._whole)
                frames[done : done + count] = self._whole[row : row + count]
            done += count

    def _place(self, output: int) -> tuple[int, int, int]:
        period, within = divmod(output, self._blocks.period_out)
        return period, *divmod(within, self._blocks.rows)


class _InterpolatingKernel:
    """Computes outputs one by one; coefficients are interpolated between the rows of a table."""

    def __init__(self, ratio: Ratio) -> None:
        self._ratio = ratio
        self._table = phase_table(ratio)
        self.slack = 0
        self.reach = 2 * ratio.taps

    def first_input(self, output: int) -> int:
        return output * self._ratio.down // self._ratio.up - self._ratio.taps + 1

    def render(self, inputs: Float32Array, base: int, first: int, frames: Float32Array) -> None:
        up, down, taps = self._ratio.up, self._ratio.down, self._ratio.taps
        phases = len(self._table) - 1
        windows = np.lib.stride_tricks.sliding_window_view(inputs, taps, axis=0)
        at_once = max(1, min(OUTPUTS_AT_ONCE, WINDOW_FLOATS_AT_ONCE // (taps * frames.shape[1])))
        for done in range(0, len(frames), at_once):
            count = min(at_once, len(frames) - done)
            whole, phase = divmod((first + done) * down, up)
            # in units of 1/up of an input frame, exact in 64 bits
            position = phase + np.arange(count, dtype=np.int64) * down
            start = whole - taps + 1 - base + position // up
            row, rest = np.divmod(position % up * phases, up)
            weight = (rest / up).astype(np.float32)[:, None]
            coefficients = self._table[row] * (np.float32(1.0) - weight)
            coefficients += self._table[row + 1] * weight
            # one product of one shape for each output
            products = np.matmul(windows[start], coefficients[:, :, None])
            frames[done : done + count] = products[:, :, 0]

"""The resampler: converts the samplerate of a stream.

The filter is a sinc with a Kaiser window. Sources: J. F. Kaiser, Nonrecursive digital filter design
using the I0-sinh window function, ISCAS 1974; J. O. Smith and P. Gossett, A flexible sampling-rate
conversion method, 1984.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from device.units import Float32Array

HALF_WIDTH = 64  # half of the filter's length, in frames at the lower rate
PASS_EDGE = 0.9  # end of the pass band, relative to the Nyquist frequency of the lower rate
STOP_BAND_DB = 98.0  # stop-band attenuation, which 127 taps reach by Kaiser's formula
PHASES_EXACT = 1024  # with more phases, coefficients are interpolated between table rows

ROWS_AT_ONCE = 128  # largest number of output frames per block matrix
BLOCK_FLOATS = 1 << 15  # largest rows x taps of a block matrix, so that OpenBLAS uses one thread
FLOATS_AT_MOST = 1 << 21  # largest number of float32 values for one ratio, 8 MB

OUTPUTS_AT_ONCE, WINDOW_FLOATS_AT_ONCE = 64, 1 << 16  # largest sizes of an interpolation step


@dataclass(frozen=True)
class Ratio:
    """Ratio of two samplerates in lowest terms, and the length of the filter."""

    up: int  # output frames per `down` input frames
    down: int
    taps: int  # filter length in input frames, even

    @classmethod
    def of(cls, rate_in: int, rate_out: int) -> "Ratio":
        """Return the ratio of two rates in Hz."""
        common = int(np.gcd(rate_in, rate_out))
        up, down = rate_out // common, rate_in // common
        return cls(up, down, 2 * -(-HALF_WIDTH * max(up, down) // up))

    @property
    def is_exact(self) -> bool:
        """Whether a table of all coefficients is small enough. If not, interpolation is used."""
        return self.up <= PHASES_EXACT and 2 * self.up * self.taps <= FLOATS_AT_MOST

    def coefficients(self, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return coefficients, (offsets, taps). offset: 0 to 1 frame after an input frame."""
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
    """Filter of a ratio that `is_exact`, as matrices of equal shape, (blocks, rows, columns).

    The coefficients repeat after a period of `period_in` input or `period_out` output frames. The
    output frames of a period are divided into blocks of `rows` frames. Block b is the product
    `matrices[b] @ inputs`. Its inputs start at input frame `offsets[b] - taps + 1` of the period.
    """

    matrices: Float32Array
    offsets: tuple[int, ...]
    rows: int
    period_out: int
    period_in: int


@lru_cache(maxsize=16)
def block_matrices(ratio: Ratio) -> BlockMatrices:
    """Return the block matrices of a ratio that `is_exact`. They are cached; do not change them.

    A matrix product of fixed shape adds in a fixed order, so its rounding is reproducible.
    """
    up, down, taps = ratio.up, ratio.down, ratio.taps
    rows_at_once = max(1, min(ROWS_AT_ONCE, BLOCK_FLOATS // taps))
    repeats = max(1, rows_at_once // up)
    period = up * repeats
    blocks = -(-period // rows_at_once)
    rows = -(-period // blocks)
    position = np.arange(period) * down // up
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
    """Return coefficients at equally spaced offsets from 0 to 1 frame, (phases + 1, taps).

    Linear interpolation between rows has an error of up to (pi/1024)^2 / 8 of full scale, -118 dB.
    """
    phases = max(8, -(-PHASES_EXACT * ratio.up // max(ratio.up, ratio.down)))
    return ratio.coefficients(np.arange(phases + 1) / phases).astype(np.float32)


class Resampler:
    """Polyphase resampler between two rates in Hz. Only one thread may use it.

    The stop band (attenuation 98 dB) starts at the Nyquist frequency of the lower rate. The pass
    band (ripple 0.001 dB) ends at 0.9 times this frequency. Block sizes do not affect the result.
    Non-finite samples become 0.

    For n output frames, call `feed` with `frames_needed(n)` frames, then `produce`. Output frame j
    corresponds to input frame j rate_in/rate_out - `latency_frames`. max_frames: largest n.
    """

    def __init__(self, rate_in: int, rate_out: int, channels: int, max_frames: int) -> None:
        self._ratio = Ratio.of(rate_in, rate_out)
        self._kernel: _BlockKernel | _InterpolatingKernel
        if self._ratio.is_exact:
            self._kernel = _BlockKernel(self._ratio, channels)
        else:
            self._kernel = _InterpolatingKernel(self._ratio)
        self.latency_frames = self._ratio.taps // 2
        self.tail_frames = self._ratio.taps  # input frames of silence until the output is silent
        # Matrix products also read memory after the fed frames, but multiply it by 0.
        most_in = -(-max_frames * self._ratio.down // self._ratio.up) + 1
        self._inputs = np.zeros((self._kernel.reach + most_in, channels), np.float32)
        self.reset()

    def reset(self) -> None:
        """Start a new stream."""
        self._inputs[:] = 0.0
        self._base = -self._ratio.taps  # input frame at _inputs[0]
        self._fed = 0  # number of input frames
        self._next = 0  # next output frame

    def frames_needed(self, frames_out: int) -> int:
        """Return how many input frames to feed before `produce` can fill `frames_out` frames."""
        if frames_out == 0:
            return 0
        last = (self._next + frames_out - 1) * self._ratio.down // self._ratio.up
        return max(0, last + 1 - self._fed)

    def feed(self, frames: Float32Array) -> None:
        """Append input frames, (n, channels), with non-finite samples replaced by 0."""
        count = len(frames)
        end = self._fed - self._base
        if end + count + self._kernel.slack > len(self._inputs):
            kept = self._kernel.first_input(self._next) - self._base
            self._base += kept
            held = end - kept
            wanted = held + count + self._kernel.slack
            before = self._inputs
            if wanted > len(before):
                self._inputs = np.zeros((2 * wanted, before.shape[1]), np.float32)
            self._inputs[:held] = before[kept:end]
            end = held
        self._fed += count
        room = self._inputs[end : end + count]
        room[...] = frames
        # A non-finite sample times a coefficient of 0 would be NaN.
        finite = np.isfinite(room)
        if not finite.all():
            room[~finite] = 0.0

    def produce(self, frames: Float32Array) -> None:
        """Fill `frames`, (n, channels), after `frames_needed(n)` input frames were fed."""
        self._kernel.render(self._inputs, self._base, self._next, frames)
        self._next += len(frames)


def frames_out(frames_in: int, rate_in: int, rate_out: int) -> int:
    """Return the number of output frames for the first `frames_in` input frames of a stream."""
    return -(-frames_in * rate_out // rate_in)


def tail_frames_out(rate_in: int, rate_out: int) -> int:
    """Return the delay of a resampler in output frames; 0 at equal rates."""
    if rate_in == rate_out:
        return 0
    return frames_out(Ratio.of(rate_in, rate_out).taps // 2, rate_in, rate_out)


class _BlockKernel:
    """Computes output frames as products with block matrices."""

    def __init__(self, ratio: Ratio, channels: int) -> None:
        self._taps = ratio.taps
        self._blocks: BlockMatrices = block_matrices(ratio)
        columns = self._blocks.matrices.shape[2]
        self._whole = np.zeros((self._blocks.rows, channels), np.float32)
        self.slack, self.reach = columns, 3 * columns

    def first_input(self, output: int) -> int:
        """Return the first input frame needed for output frames from `output` on."""
        period, block, _ = self._place(output)
        blocks = self._blocks
        return period * blocks.period_in + blocks.offsets[block] - self._taps + 1

    def render(self, inputs: Float32Array, base: int, first: int, frames: Float32Array) -> None:
        """Fill `frames` with output frames from `first` on; inputs[0] is input frame `base`."""
        blocks, columns, done = self._blocks, self.slack, 0
        while done < len(frames):
            period, block, row = self._place(first + done)
            end_row = min(blocks.rows, blocks.period_out - block * blocks.rows)
            count = min(end_row - row, len(frames) - done)
            start = period * blocks.period_in + blocks.offsets[block] - self._taps + 1 - base
            window = inputs[start : start + columns]
            if count == blocks.rows:
                np.matmul(blocks.matrices[block], window, out=frames[done : done + count])
            else:
                # The shape affects the rounding, so compute the whole block and copy some rows.
                # These rows do not depend on frames that were not fed yet.
                np.matmul(blocks.matrices[block], window, out=self._whole)
                frames[done : done + count] = self._whole[row : row + count]
            done += count

    def _place(self, output: int) -> tuple[int, int, int]:
        period, within = divmod(output, self._blocks.period_out)
        return period, *divmod(within, self._blocks.rows)


class _InterpolatingKernel:
    """Computes output frames with coefficients interpolated between the rows of a table."""

    def __init__(self, ratio: Ratio) -> None:
        self._ratio = ratio
        self._table = phase_table(ratio)
        self.slack, self.reach = 0, 2 * ratio.taps

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
            # Unit: 1/up input frame.
            position = phase + np.arange(count, dtype=np.int64) * down
            start = whole - taps + 1 - base + position // up
            row, rest = np.divmod(position % up * phases, up)
            weight = (rest / up).astype(np.float32)[:, None]
            coefficients = self._table[row] * (np.float32(1.0) - weight)
            coefficients += self._table[row + 1] * weight
            # Each output frame is a product of the same shape, so the rounding is reproducible.
            products = np.matmul(windows[start], coefficients[:, :, None])
            frames[done : done + count] = products[:, :, 0]

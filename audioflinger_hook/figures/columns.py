"""Reduction of one-dimensional signals (full scale 1) to a few values per column of a picture."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

AMPLITUDE_FLOOR = 1e-10  # -200 dB, below all colour scales
_BLOCKS_PER_COLUMN = 8  # resolution of the short-time RMS
_WINDOWS_PER_BATCH = 128  # windows in one FFT call, to limit the memory


def column_times_s(duration_s: float, columns: int) -> NDArray[np.float64]:
    """Return the time of each column's centre in seconds, shape (columns,)."""
    return (np.arange(columns, dtype=np.float64) + 0.5) * (duration_s / columns)


def envelope(
    signal: NDArray[np.floating], columns: int
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return minimum and maximum of each column, including the next column's first sample."""
    # Integer arithmetic makes the last edge equal to the signal's end.
    edges = np.arange(columns + 1, dtype=np.int64) * signal.size // columns
    lowest = np.minimum.reduceat(signal, edges[:-1])
    highest = np.maximum.reduceat(signal, edges[:-1])
    following = signal[np.minimum(edges[1:], signal.size - 1)]
    return np.minimum(lowest, following), np.maximum(highest, following)


def short_time_rms(
    signal: NDArray[np.floating], samplerate: int, columns: int, window_s: float
) -> NDArray[np.float64]:
    """Return the RMS around the centre of each column, shape (columns,).

    The window is `window_s` s or one column, whichever is longer, and shorter at the signal's ends.
    """
    block = max(1, signal.size // (columns * _BLOCKS_PER_COLUMN))
    whole = signal.size - signal.size % block
    power = np.einsum("ij,ij->i", *(2 * [signal[:whole].reshape(-1, block)]), dtype=np.float64)
    energy = np.concatenate([[0.0], np.cumsum(power)])

    column_frames = signal.size / columns
    centre = (np.arange(columns) + 0.5) * column_frames
    half_frames = 0.5 * max(window_s * samplerate, column_frames, block)
    first = np.clip(np.floor((centre - half_frames) / block), 0, power.size - 1).astype(np.int64)
    last = np.clip(np.ceil((centre + half_frames) / block), first + 1, power.size).astype(np.int64)
    # In silence, rounding errors can make the difference of two running sums negative.
    mean_square = np.maximum(energy[last] - energy[first], 0.0) / ((last - first) * block)
    return np.asarray(np.sqrt(mean_square), dtype=np.float64)


def spectrogram_db(
    signal: NDArray[np.floating],
    samplerate: int,
    *,
    window_s: float,
    columns: int,
    rows_hz: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return short-time amplitudes in dB relative to a sine of amplitude 1, (rows, columns).

    Hamming windows of `window_s` seconds are centred on the columns. `rows_hz` is ascending. Each
    row shows the larger of two amplitudes: the one interpolated at the row's frequency, and the
    largest of the FFT bins nearest to the row. Rows above the Nyquist frequency have -200 dB.
    """
    window_frames = max(4, round(window_s * samplerate))
    transform_frames = next_fast_len(2 * window_frames, real=True)
    window = np.hamming(window_frames + 1)[:-1]
    scale = 2.0 / window.sum()

    # With half a window of zeros in front, the window at index i is centred on frame i.
    padded = np.pad(signal, (window_frames // 2, window_frames))
    starts = ((np.arange(columns) + 0.5) * (signal.size / columns)).astype(np.int64)
    windows = np.lib.stride_tricks.sliding_window_view(padded, window_frames)

    bins = transform_frames // 2 + 1
    position = np.clip(rows_hz / (samplerate / transform_frames), 0.0, bins - 1.0)
    below = np.minimum(position.astype(np.int64), bins - 2)
    fraction = (position - below)[:, None]
    middle = 0.5 * (position[1:] + position[:-1])
    begins = np.ceil(np.concatenate([position[:1], middle])).astype(np.int64)
    ends = np.ceil(np.concatenate([middle, position[-1:]])).astype(np.int64)
    coarse = np.flatnonzero(ends > begins)  # rows with one bin or more of their own
    pairs = np.stack([begins, np.minimum(ends, bins - 1)], axis=1)[coarse].ravel()

    power = np.empty((rows_hz.size, starts.size))
    for first in range(0, starts.size, _WINDOWS_PER_BATCH):
        batch = starts[first : first + _WINDOWS_PER_BATCH]
        amplitude = np.abs(rfft(windows[batch] * window, transform_frames, axis=1).T) * scale
        lower = amplitude[below]
        picked = lower + (amplitude[below + 1] - lower) * fraction
        if coarse.size:
            # reduceat also reduces the bins between two pairs; these results are skipped.
            largest = np.maximum.reduceat(amplitude, pairs, axis=0)[::2]
            picked[coarse] = np.maximum(picked[coarse], largest)
        power[:, first : first + batch.size] = picked**2
    power[rows_hz > samplerate / 2.0] = 0.0
    return np.asarray(10.0 * np.log10(np.maximum(power, AMPLITUDE_FLOOR**2)), dtype=np.float64)

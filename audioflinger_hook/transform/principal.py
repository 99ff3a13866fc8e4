"""Amplitude spectra of windows, and their principal frequencies: peaks with r = A df > C_th.

Windows are periodic Hamming, zero-padded: a full-scale sine has A = 1. Equations (2) and (3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import scipy
from numpy.typing import NDArray

from audioflinger_hook.transform.arrays import ComplexArray, FloatArray, IntArray
from audioflinger_hook.transform.parameters import TransformParameters

PEAK_EXPONENT = 0.2  # for this power of A a Hamming main lobe is nearest to a parabola
HALF_POWER = 1.0 / math.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Spectra at one samplerate; pure, holds only its window, which is scaled to a sum of 2."""

    samplerate: int
    window: FloatArray
    fft_length: int

    @classmethod
    def of(cls, parameters: TransformParameters, samplerate: int) -> Spectrum:
        """Return the spectra for these parameters at a samplerate in Hz."""
        frames = parameters.window_frames(samplerate)
        phase = 2.0 * np.pi * np.arange(frames) / frames
        hamming = 0.54 - 0.46 * np.cos(phase)
        window = hamming * (2.0 / hamming.sum())
        return cls(samplerate, window, parameters.fft_length(samplerate))

    @property
    def window_frames(self) -> int:
        """N: frames in one window."""
        return self.window.size

    @property
    def bins(self) -> int:
        """NFFT/2 + 1."""
        return self.fft_length // 2 + 1

    @property
    def bin_hz(self) -> float:
        """Hz from bin to bin."""
        return self.samplerate / self.fft_length

    def transform(self, windows: FloatArray) -> ComplexArray:
        """Return 2 X[k] / sum(w) of each row: (rows, N) to (rows, bins), complex128.

        Each row is transformed separately: its bytes do not depend on the other rows.
        """
        return np.asarray(scipy.fft.rfft(windows * self.window, self.fft_length, axis=1))


def magnitude(spectra: ComplexArray) -> FloatArray:
    """Return |X| of any shape, without the overflow guard of `abs`, which triples the cost."""
    squares: FloatArray = spectra.real**2
    squares += spectra.imag**2
    return np.sqrt(squares, out=squares)


@dataclass(frozen=True)
class Principals:
    """Principal frequencies of several spectra: parallel arrays, ascending in (row, audio_hz)."""

    row: IntArray
    audio_hz: FloatArray
    amplitude: FloatArray
    bandwidth_hz: FloatArray
    r: FloatArray

    def __len__(self) -> int:
        return len(self.row)

    def take(self, chosen: IntArray | slice | NDArray[np.bool_]) -> Principals:
        """Return the chosen entries, in their order."""
        return Principals(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def boundaries(self, rows: int) -> IntArray:
        """Return rows + 1 indices; row i holds the entries from boundaries[i] to [i + 1]."""
        return self.row.searchsorted(np.arange(rows + 1))


class PrincipalFinder:
    """Finds the principal frequencies in amplitude spectra of one resolution. Pure."""

    def __init__(self, parameters: TransformParameters, bin_hz: float, bins: int) -> None:
        self._bin_hz = bin_hz
        self._threshold = parameters.threshold_hz
        self._peak_span_min = peak_span_min(parameters, bin_hz)
        self._partials_max = parameters.partials_max
        self._first, self._last = bins_in_band(parameters, bin_hz, bins)

    def find(self, amplitude: FloatArray) -> Principals:
        """Return the principal frequencies of each row of (rows, bins), at most n per row.

        These are the n with the largest r; of equals the lower frequency. For the audio thread.
        """
        found = self.all_principal(amplitude)
        return strongest(found, found.r, self._partials_max)

    def all_principal(self, amplitude: FloatArray) -> Principals:
        """Return all frequencies with r > C_th in each row of (rows, bins), not cut to n."""
        valley_left, peak, valley_right = _extrema(amplitude)
        row, bin_in_row = np.divmod(peak, amplitude.shape[1] + 1)
        flat = amplitude.reshape(-1)
        # What cannot pass the threshold is left out, before anything costly.
        able = flat.take(peak - row) * (valley_right - valley_left) > self._peak_span_min
        able &= (bin_in_row >= self._first) & (bin_in_row <= self._last)
        row, bin_in_row = row[able], bin_in_row[able]
        if not row.size:
            return Principals(row, *np.zeros((4, 0)))
        peak, valley_left, valley_right = (
            index[able] - row for index in (peak, valley_left, valley_right)
        )
        offset, height = parabola(flat.take(peak - 1), flat.take(peak), flat.take(peak + 1))
        sides = _half_widths(
            flat,
            np.concatenate((peak, peak)),
            np.concatenate((valley_left, valley_right)),
            np.concatenate((height, height)) * HALF_POWER,
        )
        bandwidth_hz = (sides[: peak.size] + sides[peak.size :]) * self._bin_hz
        r = height * bandwidth_hz
        audio_hz = (bin_in_row + offset) * self._bin_hz
        found = Principals(row, audio_hz, height, bandwidth_hz, r)
        principal = r > self._threshold
        return found if principal.all() else found.take(principal)


def strongest(found: Principals, rank: FloatArray, n: int) -> Principals:
    """Return at most n of each row: those of largest rank; if equal, the lower frequency."""
    # Entry i has more than n in its row exactly if the entry n places on is in that row too.
    if len(found) <= n or not (found.row[n:] == found.row[:-n]).any():
        return found
    order = np.lexsort((-rank, found.row))
    row_sorted = found.row[order]
    place = np.arange(len(found)) - np.searchsorted(row_sorted, row_sorted)
    return found.take(np.sort(order[place < n]))


def bins_in_band(parameters: TransformParameters, bin_hz: float, bins: int) -> tuple[int, int]:
    """Return the first and the last bin on which a peak counts; 1 and 0 if there is none."""
    hz = np.arange(bins) * bin_hz
    in_band = np.flatnonzero((hz >= parameters.band_low_hz) & (hz <= parameters.band_high_hz))
    in_band = in_band[(in_band >= 1) & (in_band <= bins - 2)]
    return (int(in_band[0]), int(in_band[-1])) if in_band.size else (1, 0)


def peak_span_min(parameters: TransformParameters, bin_hz: float) -> float:
    """Return the amplitude times bins between valleys under which no peak has r > C_th.

    No bandwidth exceeds that span. Interpolation raises a peak by at most 9/8 in A^0.2 (the
    parabola through l = 0 and m = r).
    """
    return float(parameters.threshold_hz / ((9 / 8) ** (1 / PEAK_EXPONENT) * bin_hz))


def _extrema(amplitude: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return each peak with the valleys to its left and right, as indices at a pitch of bins + 1.

    A peak is higher than the bin to its left and not lower than that to its right. Each change of
    direction is a valley, a peak, a valley ... The one bin between rows counts as a peak; its
    caller leaves it out, as it lies in no band.
    """
    rows, bins = amplitude.shape
    rising = np.empty((rows, bins + 1), dtype=bool)
    rising[:, 0] = False
    rising[:, bins] = True
    np.greater(amplitude[:, 1:], amplitude[:, :-1], out=rising[:, 1:bins])
    direction = rising.reshape(-1)
    changes = (direction[1:] != direction[:-1]).nonzero()[0]
    return changes[:-1:2], changes[1::2], changes[2::2]


def parabola(
    left: FloatArray, middle: FloatArray, right: FloatArray, curved: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the peak's offset in bins and its height, from three bins around a maximum.

    curved: the three A^0.2 are taken to be curved at least by this share of the middle one.
    """
    left, middle, right = left**PEAK_EXPONENT, middle**PEAK_EXPONENT, right**PEAK_EXPONENT
    curvature = left - 2.0 * middle + right
    if curved:
        curvature = np.minimum(curvature, -curved * middle)
    else:
        # Rounding in the power can flatten the three into a line: its peak is the middle bin.
        curvature = np.where(curvature < 0.0, curvature, -np.inf)
    offset = (left - right) / (2.0 * curvature)
    return offset, (middle - (left - right) * offset / 4.0) ** (1.0 / PEAK_EXPONENT)


def _half_widths(
    flat: FloatArray, peak: IntArray, valley: IntArray, level: FloatArray
) -> FloatArray:
    """Return how far from each peak, in bins, the walk to its valley falls under its level.

    The amplitude never rises in between, so bisection finds the crossing. A walk that never falls
    under its level ends at its valley.
    """
    inside, outside = peak, valley
    for _ in range(int(np.abs(valley - peak).max()).bit_length()):
        middle = (inside + outside) >> 1
        below = flat.take(middle) < level
        outside = np.where(below, middle, outside)
        inside = np.where(below, inside, middle)
    above, under = flat.take(inside), flat.take(outside)
    # Where the valley itself stands above the level the whole step counts: the walk ends there.
    step = np.maximum(above - np.minimum(under, level), np.finfo(np.float64).tiny)
    fraction = np.maximum(above - level, 0.0) / step
    # Distances, not positions: those would round by where in the batch the row stands.
    return np.asarray(np.abs(inside - peak) + fraction * np.abs(outside - inside))

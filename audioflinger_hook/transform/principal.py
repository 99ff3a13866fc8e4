"""Principal frequencies by the paper's equations (2) and (3): spectral peaks with r = A df > C_th.

A is the amplitude and df the half-power bandwidth of a peak; C_th is a threshold. A full-scale sine
has A = 1. The window is a periodic Hamming window; zeros are appended before the FFT.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
import scipy
from numpy.typing import NDArray

from audioflinger_hook.transform.arrays import ComplexArray, FloatArray, IntArray
from audioflinger_hook.transform.parameters import TransformParameters

PEAK_EXPONENT = 0.2  # with this exponent the main lobe of a Hamming window is almost a parabola
HALF_POWER = 1.0 / math.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Computes spectra of sound. samplerate: Hz. window: periodic Hamming window with the sum 2."""

    samplerate: int
    window: FloatArray
    fft_length: int

    @classmethod
    def of(cls, parameters: TransformParameters, samplerate: int) -> "Spectrum":
        """Return the `Spectrum` for parameters and a samplerate in Hz."""
        frames = parameters.window_frames(samplerate)
        hamming = 0.54 - 0.46 * np.cos(2.0 * np.pi * np.arange(frames) / frames)
        return cls(samplerate, hamming * (2.0 / hamming.sum()), parameters.fft_length(samplerate))

    @property
    def window_frames(self) -> int:
        """N, the number of frames in a window."""
        return self.window.size

    @property
    def bins(self) -> int:
        """Number of bins, NFFT/2 + 1."""
        return self.fft_length // 2 + 1

    @property
    def bin_hz(self) -> float:
        """Distance between neighbouring bins in Hz."""
        return self.samplerate / self.fft_length

    def transform(self, windows: FloatArray) -> ComplexArray:
        """Return spectra, (rows, bins), of windows, (rows, N). A full-scale sine has the peak 1."""
        return np.asarray(scipy.fft.rfft(windows * self.window, self.fft_length, axis=1))


def magnitude(spectra: ComplexArray) -> FloatArray:
    """Return |X|, of any shape, faster than `abs` and without protection against overflow."""
    squares: FloatArray = spectra.real**2
    squares += spectra.imag**2
    return np.sqrt(squares, out=squares)


@dataclass(frozen=True)
class Principals:
    """Principal frequencies of several spectra, sorted by row (spectrum), then by audio_hz."""

    row: IntArray
    audio_hz: FloatArray
    amplitude: FloatArray
    bandwidth_hz: FloatArray
    r: FloatArray

    def __len__(self) -> int:
        return len(self.row)

    def take(self, chosen: IntArray | slice | NDArray[np.bool_]) -> "Principals":
        """Return the chosen entries."""
        return Principals(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def boundaries(self, rows: int) -> IntArray:
        """Return indices b, (rows + 1,). The entries of row i are b[i] to b[i + 1] - 1."""
        return self.row.searchsorted(np.arange(rows + 1))


class PrincipalFinder:
    """Finds the principal frequencies in amplitude spectra with `bins` bins of `bin_hz` Hz each."""

    def __init__(self, parameters: TransformParameters, bin_hz: float, bins: int) -> None:
        self._bin_hz = bin_hz
        self._threshold = parameters.threshold_hz
        self._peak_span_min = peak_span_min(parameters, bin_hz)
        self._partials_max = parameters.partials_max
        self._first, self._last = bins_in_band(parameters, bin_hz, bins)

    def find(self, amplitude: FloatArray) -> Principals:
        """Return up to `partials_max` principal frequencies of largest r in each row (spectrum)."""
        found = self.all_principal(amplitude)
        return strongest(found, found.r, self._partials_max)

    def all_principal(self, amplitude: FloatArray) -> Principals:
        """Return all principal frequencies of spectra. amplitude: (spectra, bins)."""
        valley_left, peak, valley_right = _extrema(amplitude)
        row, bin_in_row = np.divmod(peak, amplitude.shape[1] + 1)
        flat = amplitude.reshape(-1)
        # A fast test first excludes peaks that cannot pass the threshold.
        able = flat.take(peak - row) * (valley_right - valley_left) > self._peak_span_min
        able &= (bin_in_row >= self._first) & (bin_in_row <= self._last)
        row, bin_in_row = row[able], bin_in_row[able]
        if not row.size:
            return Principals(row, *np.zeros((4, 0)))
        peak, valley_left, valley_right = (
            index[able] - row for index in (peak, valley_left, valley_right)
        )
        offset, height = parabola(flat.take(peak - 1), flat.take(peak), flat.take(peak + 1))
        sides = _widths(
            flat,
            np.concatenate((peak, peak)),
            np.concatenate((valley_left, valley_right)),
            np.concatenate((height, height)) * HALF_POWER,
        )
        bandwidth_hz = (sides[: peak.size] + sides[peak.size :]) * self._bin_hz
        r = height * bandwidth_hz
        found = Principals(row, (bin_in_row + offset) * self._bin_hz, height, bandwidth_hz, r)
        principal = r > self._threshold
        return found if principal.all() else found.take(principal)


def strongest(found: Principals, rank: FloatArray, n: int) -> Principals:
    """Return the n entries of largest rank in each row; for equal ranks, the lower frequencies."""
    # A row has more than n entries if entries at a distance of n have the same row.
    if len(found) <= n or not (found.row[n:] == found.row[:-n]).any():
        return found
    order = np.lexsort((-rank, found.row))
    row_sorted = found.row[order]
    place = np.arange(len(found)) - np.searchsorted(row_sorted, row_sorted)
    return found.take(np.sort(order[place < n]))


def bins_in_band(parameters: TransformParameters, bin_hz: float, bins: int) -> tuple[int, int]:
    """Return the first and the last bin in the analysed band, or (1, 0) if it contains no bin."""
    hz = np.arange(bins) * bin_hz
    in_band = np.flatnonzero((hz >= parameters.band_low_hz) & (hz <= parameters.band_high_hz))
    in_band = in_band[(in_band >= 1) & (in_band <= bins - 2)]
    return (int(in_band[0]), int(in_band[-1])) if in_band.size else (1, 0)


def peak_span_min(parameters: TransformParameters, bin_hz: float) -> float:
    """Return the least product of amplitude and valley distance (bins) of peaks with r > C_th.

    The valleys are the minima on both sides of a peak. Their distance is at least the bandwidth.
    Interpolation raises A^0.2 of a peak by a factor of at most 9/8.
    """
    return float(parameters.threshold_hz / ((9 / 8) ** (1 / PEAK_EXPONENT) * bin_hz))


def _extrema(amplitude: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return the indices of the left valley, the peak and the right valley of each peak.

    A peak is higher than its left neighbour and at least as high as its right neighbour. Indices
    count bins + 1 entries per row. A row's last entry appears as a peak, but is outside the band.
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
    """Return offset (bins from the middle) and height of a peak, from a parabola through A^0.2.

    left, middle, right: amplitudes A of three neighbouring bins. curved: lower bound of the
    parabola's curvature (magnitude), as a share of the middle value.
    """
    left, middle, right = left**PEAK_EXPONENT, middle**PEAK_EXPONENT, right**PEAK_EXPONENT
    curvature = left - 2.0 * middle + right
    if curved:
        curvature = np.minimum(curvature, -curved * middle)
    else:
        # If rounding makes the three values collinear, the peak is the middle bin.
        curvature = np.where(curvature < 0.0, curvature, -np.inf)
    offset = (left - right) / (2.0 * curvature)
    return offset, (middle - (left - right) * offset / 4.0) ** (1.0 / PEAK_EXPONENT)


def _widths(flat: FloatArray, peak: IntArray, valley: IntArray, level: FloatArray) -> FloatArray:
    """Return the distance (bins) from each peak to the point at which the amplitude equals `level`.

    From peak to valley the amplitude never rises, so bisection finds the point. If the amplitude
    stays above `level`, the point is the valley.
    """
    inside, outside = peak, valley
    for _ in range(int(np.abs(valley - peak).max()).bit_length()):
        middle = (inside + outside) >> 1
        below = flat.take(middle) < level
        outside = np.where(below, middle, outside)
        inside = np.where(below, inside, middle)
    above, under = flat.take(inside), flat.take(outside)
    # If the valley is above the level, the fraction becomes 1.
    step = np.maximum(above - np.minimum(under, level), np.finfo(np.float64).tiny)
    fraction = np.maximum(above - level, 0.0) / step
    # Return distances, because the rounding of positions would depend on the row.
    return np.asarray(np.abs(inside - peak) + fraction * np.abs(outside - inside))

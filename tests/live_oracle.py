"""The live form's analysis in NumPy, an oracle for the compiled one.

Whole arrays at a time where the compiled one goes bin by bin: images are cleared by scattered
assignment, half power is found by bisection, the strongest by sorting. It shares no code with
`analysis.py` and takes from the package only what the reference form has: the extrema of a row
and the parabola through a peak, which are held against an oracle of their own.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft
from scipy.signal.windows import hamming

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.arrays import FloatArray, IntArray
from audioflinger_hook.transform.principal import Principals, _extrema, parabola
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum, magnitude

IMAGE_REACH_WINDOWS = 75.0
NEIGHBOURS = np.arange(-7, 8)
TABLE_BINS_A_BIN = 32
TINY = float(np.finfo(np.float64).tiny)


class LiveOracle:
    """Principal frequencies as `LiveAnalysis` is to find them; attributes switch rules off."""

    def __init__(self, parameters: TransformParameters, spectrum: Spectrum, bins: int) -> None:
        self.parameters = parameters
        self.bins, self.bin_hz = bins, spectrum.bin_hz
        self.weakest_image = parameters.threshold_hz / parameters.unit_strength_hz(
            round(spectrum.bin_hz * spectrum.fft_length)
        )
        self.side_lobe = 0.01
        self.images = ImageRemoval(spectrum, bins)

    def all_principal(self, spectra: ComplexArray) -> Principals:
        """Return everything with r > C_th in each row."""
        spectra = spectra[:, : self.bins]
        amplitude = magnitude(spectra)
        self.images.clear(spectra, amplitude, self.weakest_image)
        of_rows = [self._principal_in_row(row) for row in amplitude]
        row = np.repeat(np.arange(len(of_rows)), [len(found) for found in of_rows])
        return Principals(row, *np.concatenate((np.zeros((0, 4)), *of_rows)).T)

    def strongest(self, spectra: ComplexArray) -> Principals:
        """Return at most n of each row, without what may be side lobes."""
        return self.selected(self.all_principal(spectra), len(spectra))

    def selected(self, found: Principals, rows: int) -> Principals:
        """Return those of so many rows that `strongest` keeps."""
        keep: list[int] = []
        for row in range(rows):
            mine = (found.row == row).nonzero()[0]
            if mine.size:
                mine = mine[found.amplitude[mine] > self.side_lobe * found.amplitude[mine].max()]
                by_r = (-found.r[mine]).argsort(kind="stable")
                keep += sorted(mine[by_r[: self.parameters.partials_max]])
        return found.take(np.array(keep, dtype=np.intp))

    def _principal_in_row(self, amplitude: FloatArray) -> FloatArray:
        """Return audio_hz, amplitude, bandwidth_hz and r of each, (found, 4)."""
        valley_left, peak, valley_right = _extrema(amplitude[None, :])
        hz = peak * self.bin_hz
        of_band = (hz >= self.parameters.band_low_hz) & (hz <= self.parameters.band_high_hz)
        valley_left, peak, valley_right = valley_left[of_band], peak[of_band], valley_right[of_band]
        if not peak.size:
            return np.zeros((0, 4))
        offset, height = parabola(amplitude[peak - 1], amplitude[peak], amplitude[peak + 1])
        bandwidth = half_power_on_bells(amplitude, peak, valley_left, offset, height)
        bandwidth += half_power_on_bells(amplitude, peak, valley_right, offset, height)
        bandwidth *= self.bin_hz
        r = height * bandwidth
        found: FloatArray = np.stack(((peak + offset) * self.bin_hz, height, bandwidth, r), axis=1)
        return found[r > self.parameters.threshold_hz]


def half_power_on_bells(
    amplitude: FloatArray, peak: IntArray, valley: IntArray, offset: FloatArray, height: FloatArray
) -> FloatArray:
    """Return bins from each refined top to half power on the side of its valley.

    ln A is linear in the squared distance from the top between the two bins around the edge. A
    side that never falls under half power ends at its valley.
    """
    level = height / np.sqrt(2.0)
    inside, outside = peak, valley
    for _ in range(int(np.abs(valley - peak).max()).bit_length()):
        middle = (inside + outside) >> 1
        below = amplitude[middle] < level
        outside = np.where(below, middle, outside)
        inside = np.where(below, inside, middle)
    above = np.maximum(amplitude[inside], level)
    under = np.maximum(np.minimum(amplitude[outside], level), TINY)
    near, far = ((inside - peak) - offset) ** 2, ((outside - peak) - offset) ** 2
    above = np.log(above / level)
    fraction = above / np.maximum(above - np.log(under / level), TINY)
    edge: FloatArray = np.sqrt(near + fraction * (far - near))
    return edge


class ImageRemoval:
    """Removes from amplitude spectra what the images of strong low peaks add around them."""

    def __init__(self, spectrum: Spectrum, bins: int) -> None:
        frames, length = spectrum.window_frames, spectrum.fft_length
        room = min(spectrum.bins // 2 - 1, bins - 1) - int(NEIGHBOURS[-1])
        self.low_bins = max(0, min(int(IMAGE_REACH_WINDOWS * length / frames), room))
        turn = 2.0 * np.pi * np.arange(self.low_bins + 1 + NEIGHBOURS[-1]) * (frames / 2) / length
        self.cosine, self.sine = np.cos(turn), np.sin(turn)
        fine = rfft(hamming(frames, sym=False), TABLE_BINS_A_BIN * length)
        fine = fine[: TABLE_BINS_A_BIN * 2 * self.cosine.size + 2]
        entries = np.arange(fine.size) / TABLE_BINS_A_BIN
        turned = fine * np.exp(2j * np.pi * entries * (frames / 2) / length)
        self.table: FloatArray = turned.real / turned[0].real

    def clear(self, spectra: ComplexArray, amplitude: FloatArray, weakest: float) -> None:
        """Rewrite the low bins of amplitude (rows, bins) from spectra (rows, bins)."""
        low = amplitude[:, : self.low_bins + 1]
        middle = low[:, 1:-1]
        row, before_peak = (
            (middle > low[:, :-2]) & (middle >= low[:, 2:]) & (middle > weakest)
        ).nonzero()
        if not row.size:
            return
        peak = before_peak + 1
        offset, _ = parabola(low[row, before_peak], low[row, peak], low[row, peak + 1])
        turned = spectra[row, peak] * (self.cosine[peak] + 1j * self.sine[peak])
        tone = (turned / self.window_at(np.abs(offset)))[:, None]

        # Where neighbourhoods of peaks overlap, in the valley between, the upper one's stands.
        bins = np.maximum(peak[:, None] + NEIGHBOURS, 0)
        turned = spectra[row[:, None], bins] * (self.cosine[bins] + 1j * self.sine[bins])
        image = self.window_at(bins + (peak + offset)[:, None])
        amplitude[row[:, None], bins] = np.abs(turned - np.conj(tone) * image)

    def window_at(self, distance_bins: FloatArray) -> FloatArray:
        """Return the window's real spectrum, 1 at 0, between the entries of the table."""
        position = distance_bins * TABLE_BINS_A_BIN
        below = position.astype(np.intp)
        here = self.table[below]
        value: FloatArray = here + (position - below) * (self.table[below + 1] - here)
        return value

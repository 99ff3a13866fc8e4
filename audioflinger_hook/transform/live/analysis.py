"""The live form's analysis: spectra to principal frequencies.

It goes the reference form's way (`principal.py`) with three additions:

- Low tones are cleared of their own image, the half of a real tone at negative frequency. A peak
  stands on the far side lobes of its image, which a Hamming window lets fall off slowly. They pull
  it to and fro as its phase turns: at 55 Hz by 4 Hz of audio, and wherever the hop nearly keeps
  step with the tone so slowly that it is felt as a wobble. The image is known from the peak
  itself, so it is computed and taken away.
- The edge of a half-power bandwidth is placed on a bell, not on a straight line between two bins:
  so a tone's bandwidth does not depend on where between two bins it stands (1.4 % on straight
  lines at 48 kHz, a tenth of it here).
- What stands 40 dB under a row's highest is left out: it may be its side lobe.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray
from audioflinger_hook.transform.design.analysis import (
    NEIGHBOURS,
    TABLE_BINS_A_BIN,
    AnalysisDesign,
)
from audioflinger_hook.transform.principal import (
    HALF_POWER,
    Principals,
    able_peaks,
    parabola,
    strongest,
)
from audioflinger_hook.transform.spectrum import ComplexArray, magnitude

TWICE_BELOW = 20
"""Peaks under this bin, 210 Hz, are cleared again, by what the first time has made of them. So
near to its image a peak is pulled so far that the image is first looked up in a wrong place."""

PEAK_FLOOR = 1e-6
"""The bins beside a peak count as this share of it at least. Where the window's spectrum has a
zero, A^0.2 would make 1e-3 of a rounding of 1e-16, and ln A even more."""

PEAK_CURVED = 1e-6
"""The three A^0.2 around a top are curved at least by this share of it ..."""

APART_FROM = 1.0 + 1e-9
"""... and two amplitudes count as different from this ratio on, so that rounding decides nothing
between equals: the spectrum of a single sample is flat."""

LOWER_FIRST = 1e-10
"""Of two peaks with the same r the lower is the stronger: a bin up takes this share of r."""

BESIDE, NEIGHBOURHOOD = np.arange(-1, 2), np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
"""Bins from a peak's."""

TINY = float(np.finfo(np.float64).tiny)


class LiveAnalysis:
    """Finds the principal frequencies in spectra of one resolution, as the live form wants them.

    Each row's result depends on that row alone. Pure: holds no state beyond its design.
    """

    def __init__(self, design: AnalysisDesign) -> None:
        self._bins, self._bin_hz = design.bins, design.bin_hz
        self._first, self._last = design.first_bin, design.last_bin
        self._threshold_hz = design.threshold_hz
        self._peak_span_min = design.peak_span_min
        self._weakest_image, self._weakest_share = design.weakest_image, design.weakest_share
        self._side_lobe = design.side_lobe
        self._partials_max = design.partials_max
        self._turn, self._table = design.image_turn, design.image_table
        self._first_sample = design.image_first

    def all_principal(self, spectra: ComplexArray) -> Principals:
        """Return everything with r > C_th in each row of (rows, columns), nothing left out."""
        spectra = spectra[:, : self._bins]
        amplitude = magnitude(spectra)
        self._clear_images(spectra, amplitude)
        peaks = able_peaks(amplitude, self._peak_span_min, self._first, self._last, APART_FROM)
        if not peaks.row.size:
            return Principals(peaks.row, *np.zeros((4, 0)))
        flat, peak = amplitude.reshape(-1), peaks.peak
        offset, height = _refined(flat.take(peak[:, None] + BESIDE))
        sides = _half_power_on_bells(
            flat,
            np.concatenate((peak, peak)),
            np.concatenate((peaks.valley_left, peaks.valley_right)),
            np.concatenate((offset, offset)),
            np.concatenate((height, height)) * HALF_POWER,
        )
        bandwidth_hz = (sides[: peak.size] + sides[peak.size :]) * self._bin_hz
        r = height * bandwidth_hz
        audio_hz = (peaks.bin + offset) * self._bin_hz
        found = Principals(peaks.row, audio_hz, height, bandwidth_hz, r)
        return found.take(r > self._threshold_hz)

    def strongest(self, spectra: ComplexArray) -> Principals:
        """Return what the live form plays of each row of (rows, columns), at most n a row.

        A loud tone's side lobes can pass r > C_th now and then. Their own vibration is 80 dB
        down, but each takes its share of P_k from the tone, which then flutters by a percent: so
        what stands 40 dB under a row's highest is left out. Of more than n then the n with the
        largest r are kept; of equals the lower frequency. Called on the audio thread.
        """
        found = self.all_principal(spectra)
        highest = np.zeros(len(spectra))
        np.maximum.at(highest, found.row, found.amplitude)
        lobes = found.amplitude <= self._side_lobe * highest.take(found.row)
        if lobes.any():
            found = found.take(~lobes)
        bins = np.rint(found.audio_hz / self._bin_hz)
        return strongest(found, found.r - found.r * (LOWER_FIRST * bins), self._partials_max)

    def _clear_images(self, spectra: ComplexArray, amplitude: FloatArray) -> None:
        """Rewrite the low amplitudes (rows, bins) without what images of strong peaks add."""
        low = amplitude[:, : max(0, self._turn.shape[1] - NEIGHBOURS) + 1]
        middle = low[:, 1:-1]
        highest = middle.max(axis=1, initial=0.0, keepdims=True)
        weakest = np.maximum(self._weakest_image, self._weakest_share * highest)
        row, before_peak = (
            (middle > APART_FROM * low[:, :-2])
            & ~(low[:, 2:] > APART_FROM * middle)
            & (middle > weakest)
        ).nonzero()
        if not row.size:
            return
        peak = before_peak + 1
        flat, first = amplitude.reshape(-1), row * amplitude.shape[1]
        offset, _ = _refined(flat.take((first + peak)[:, None] + BESIDE))
        near = peak < TWICE_BELOW
        if near.any():
            tops = self._without_image(spectra, row[near], peak[near], offset[near], BESIDE)
            still = tops.argmax(axis=1) == 1
            offset[near.nonzero()[0][still]] = _refined(tops[still])[0]
        # Where neighbourhoods of peaks overlap, in the valley between, the upper one's stands.
        bins = np.maximum(peak[:, None] + NEIGHBOURHOOD, 0)
        cleared = self._without_image(spectra, row, peak, offset, NEIGHBOURHOOD)
        amplitude[row[:, None], bins] = cleared

    def _without_image(
        self,
        spectra: ComplexArray,
        row: IntArray,
        peak: IntArray,
        offset: FloatArray,
        places: IntArray,
    ) -> FloatArray:
        """Return amplitudes (peaks, places) around each peak without the image of its tone.

        places: in bins from the peaks'; those below bin 0 count as it. With phases counted
        from the window's centre its spectrum is real, but for its first sample, 0.08, which has no
        partner on the other side. There the image is the tone's conjugate, on the window's spectrum
        around minus the tone's frequency. Of the first sample it adds the same number to all bins.
        """
        cosine, sine = self._turn
        height = self._window_at(np.abs(offset))
        tone = (spectra[row, peak] * (cosine[peak] + 1j * sine[peak]) / height)[:, None]
        # A bin is a quarter of a turn there, or a little less.
        angle = (0.5 * np.pi) * offset
        square = angle * angle
        across, along = 1.0 - square * (0.5 - square / 24.0), angle * (1.0 - square / 6.0)
        share = self._first_sample / height
        first = (share * np.conj(spectra[row, peak]) * (across + 1j * along))[:, None]
        bins = np.maximum(peak[:, None] + places, 0)
        turned = (spectra[row[:, None], bins] - first) * (cosine[bins] + 1j * sine[bins])
        image = self._window_at(bins + (peak + offset)[:, None])
        cleared: FloatArray = np.abs(turned - np.conj(tone) * image)
        return cleared

    def _window_at(self, distance_bins: FloatArray) -> FloatArray:
        """Return the window's real spectrum, 1 at 0, on lines between the entries of its table."""
        position = distance_bins * TABLE_BINS_A_BIN
        below = position.astype(np.intp)
        here = self._table.take(below)
        value: FloatArray = here + (position - below) * (self._table.take(below + 1) - here)
        return value


def _refined(around: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return offset in bins and height of the refined tops, of (peaks, 3) amplitudes around."""
    left, top, right = around.T
    floor = PEAK_FLOOR * top
    return parabola(np.maximum(left, floor), top, np.maximum(right, floor), PEAK_CURVED)


def _half_power_on_bells(
    flat: FloatArray, peak: IntArray, valley: IntArray, offset: FloatArray, level: FloatArray
) -> FloatArray:
    """Return bins from each refined top to half power, on the side of its valley.

    A window's main lobe is nearly a Gaussian: ln A is linear in the squared distance from its
    top. A side that never falls under half power ends at its valley.
    """
    inside, outside = peak, valley
    # Between a peak and its valley no amplitude is above the one before: bisection.
    for _ in range(int(np.abs(valley - peak).max()).bit_length()):
        middle = (inside + outside) >> 1
        below = flat.take(middle) < level
        outside = np.where(below, middle, outside)
        inside = np.where(below, inside, middle)
    above = np.maximum(flat.take(inside), level)
    under = np.maximum(np.minimum(flat.take(outside), level), PEAK_FLOOR * level)
    near, far = ((inside - peak) - offset) ** 2, ((outside - peak) - offset) ** 2
    above = np.log(above / level)
    fraction = above / np.maximum(above - np.log(under / level), TINY)
    edge: FloatArray = np.sqrt(near + fraction * (far - near))
    return edge

"""The principal frequencies of spectra: steps 3 and 4 of docs/transform.md, in the live form's way.

Spectra are rows of (rows, bins), complex, scaled so that a full-scale sine has magnitude 1. Each
row's result depends on that row alone.
"""

from typing import Any

import numpy as np

from audioflinger_hook.transform import TransformParameters, principal
from audioflinger_hook.transform.arrays import ComplexArray, FloatArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.analysis import NEIGHBOURS, TABLE_BINS_A_BIN
from audioflinger_hook.transform.principal import HALF_POWER, Principals, Spectrum, parabola

APART_FROM, FLOOR, CURVED, LOWER_FIRST = 1.0 + 1e-9, 1e-6, 1e-6, 1e-10
"""Ties: amplitudes differ from this ratio on; a bin beside a peak counts as at least this share of
it; so far the A^0.2 around it are curved at least; a peak loses so much of r for each bin up."""
TWICE_BELOW = 20
"""Below this bin, 210 Hz, the image moves a peak so far that its place is found in two steps."""
BESIDE, AROUND = np.arange(-1, 2), np.arange(-NEIGHBOURS, NEIGHBOURS + 1)


def all_principal(s: Any, spectra: ComplexArray) -> Principals:
    """Return every peak with r > C_th, ascending in row and frequency: equations (2) and (3)."""
    amplitude = without_images(s, spectra)
    rises = np.zeros((len(amplitude), s.bins + 1), dtype=bool)  # to a bin from the one before
    rises[:, 1:-1] = amplitude[:, 1:] > APART_FROM * amplitude[:, :-1]
    down, up = rises[:, :-1], ~rises[:, 1:]  # whether a peak's flank goes on below a bin, and above
    up[:, -1] = False
    row, peak = np.nonzero(down & up)
    in_band = (peak >= s.first_bin) & (peak <= s.last_bin)
    row, peak = row[in_band], peak[in_band]
    offset, height = _refined(amplitude[row[:, None], peak[:, None] + BESIDE])
    flank = (amplitude, row, peak, offset, HALF_POWER * height)
    bandwidth_hz = (_half_power(*flank, down, -1) + _half_power(*flank, up, 1)) * s.bin_hz
    r = height * bandwidth_hz
    found = Principals(row, (peak + offset) * s.bin_hz, height, bandwidth_hz, r)
    return found.take(r > s.threshold_hz)


def strongest_principal(s: Any, spectra: ComplexArray) -> Principals:
    """Return what vibrates of each row: no side lobes of its highest peak, and the n largest r."""
    found, highest = all_principal(s, spectra), np.zeros(len(spectra))
    np.maximum.at(highest, found.row, found.amplitude)
    found = found.take(found.amplitude > s.side_lobe * highest[found.row])
    bins = np.rint(found.audio_hz / s.bin_hz)
    return principal.strongest(found, found.r - found.r * (LOWER_FIRST * bins), s.partials_max)


def _refined(around):
    """Return offset in bins and height of peaks from (peaks, 3) amplitudes: a parabola in A^0.2."""
    left, top, right = around.T
    return parabola(np.maximum(left, FLOOR * top), top, np.maximum(right, FLOOR * top), CURVED)


def _half_power(amplitude, row, peak, offset, level, goes_on, step):
    """Return bins from each refined peak to half power, on the flank above (step 1) or below (-1).
    A main lobe is nearly a Gaussian: ln A is linear in the squared distance from its top. A flank
    that stays over half power ends at its valley."""
    inside = outside = peak
    moves = np.ones(peak.size, dtype=bool)
    while moves.any():
        inside = np.where(moves, outside, inside)
        outside = inside + step * goes_on[row, inside]
        moves = (outside != inside) & (amplitude[row, outside] >= level)
    near, far = (inside - peak - offset) ** 2, (outside - peak - offset) ** 2
    above = np.log(np.maximum(amplitude[row, inside], level) / level)
    under = np.log(np.clip(amplitude[row, outside], FLOOR * level, level) / level)
    return np.sqrt(near + above / np.maximum(above - under, 1e-300) * (far - near))


def without_images(s: Any, spectra: ComplexArray) -> FloatArray:
    """Return the amplitudes (rows, bins) without the mirror images of strong low tones. A real tone
    has a conjugate at its negative frequency, whose side lobes pull its peak about. The tone is
    known from the peak, so its image is computed and subtracted around the peak."""
    amplitude = np.hypot(spectra.real, spectra.imag)
    low = amplitude[:, : max(0, s.image_turn.shape[1] - NEIGHBOURS) + 1]
    middle = low[:, 1:-1]
    weakest = s.weakest_share * middle.max(axis=1, initial=0.0, keepdims=True)
    is_peak = (middle > APART_FROM * low[:, :-2]) & ~(low[:, 2:] > APART_FROM * middle)
    row, peak = np.nonzero(is_peak & (middle > np.maximum(s.weakest_image, weakest)))
    peak += 1
    offset, _ = _refined(amplitude[row[:, None], peak[:, None] + BESIDE])
    twice = np.flatnonzero(peak < TWICE_BELOW)
    tops = _without_image(s, spectra, row[twice], peak[twice], offset[twice], BESIDE)
    peaked = tops.argmax(axis=1) == 1
    offset[twice[peaked]] = _refined(tops[peaked])[0]
    # Where neighbourhoods of two peaks overlap, the upper one's stands: it is written last.
    cleared = _without_image(s, spectra, row, peak, offset, AROUND)
    amplitude[row[:, None], np.maximum(peak[:, None] + AROUND, 0)] = cleared
    return amplitude


def _without_image(s, spectra, row, peak, offset, around):
    """Return amplitudes (peaks, around) at bins counted from each peak, without its own image.
    With phases counted from the window's centre the window's spectrum W is real: a tone with peak
    t at bin k has t / W(offset), and its image at bin j is the conjugate times W(j + k + offset).
    The window's first sample has no partner on the other side: it adds the same to all bins."""
    turn = s.image_turn[0] + 1j * s.image_turn[1]
    places = np.arange(s.image_table.size) / TABLE_BINS_A_BIN
    height = np.interp(np.abs(offset), places, s.image_table)
    tone = spectra[row, peak] * turn[peak] / height
    angle = 0.5 * np.pi * offset  # a bin is a quarter of a turn there, or a little less
    square = angle * angle
    turned = 1.0 - square * (0.5 - square / 24.0) + 1j * angle * (1.0 - square / 6.0)
    first = s.image_first / height * np.conj(spectra[row, peak]) * turned
    bins = np.maximum(peak[:, None] + around, 0)
    image = np.interp(bins + (peak + offset)[:, None], places, s.image_table)
    here = (spectra[row[:, None], bins] - first[:, None]) * turn[bins]
    return np.abs(here - np.conj(tone)[:, None] * image)


def principal_in(
    windows: FloatArray, samplerate: int, parameters: TransformParameters | None = None
) -> Principals:
    """Return everything principal in band-passed windows (rows, N), not cut to n."""
    design = LiveDesign.of(parameters or TransformParameters(), samplerate).analysis
    spectra = Spectrum(samplerate, design.window, design.fft_length).transform(windows)
    return all_principal(design, spectra[:, : design.bins])

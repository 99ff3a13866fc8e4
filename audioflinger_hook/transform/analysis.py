"""The live form's analysis: spectra to principal frequencies, in one compiled call.

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
from scipy.signal import zoom_fft
from scipy.signal.windows import hamming

from audioflinger_hook.transform._analysis import (
    NEIGHBOURS,
    SCRATCH_A_BIN,
    TABLE_BINS_A_BIN,
    find,
)
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import Principals, bins_in_band, peak_span_min
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum

IMAGE_REACH_WINDOWS = 75.0
"""Peaks below this many times 1/T (1.6 kHz) are cleared; from there the image is about -70 dB."""

SIDE_LOBE = 10 ** (-40 / 20)
"""Side lobes of a Hamming window stand 42.7 dB under their peak."""


class LiveAnalysis:
    """Finds the principal frequencies in spectra of one resolution, as the live form wants them.

    spectrum: what the spectra come from; bins: how many of their columns are looked at. Each
    row's result depends on that row alone. Held by one thread at a time: it owns scratch memory.
    """

    def __init__(self, parameters: TransformParameters, spectrum: Spectrum, bins: int) -> None:
        self._bins = bins
        self._bin_hz = spectrum.bin_hz
        self._first, self._last = bins_in_band(parameters, spectrum.bin_hz, bins)
        self._threshold_hz = parameters.threshold_hz
        self._peak_span_min = peak_span_min(parameters, spectrum.bin_hz)
        # A steady tone is principal from here up; what is weaker is no tone that could wobble.
        self._weakest_image = parameters.threshold_hz / parameters.unit_strength_hz(
            spectrum.samplerate
        )
        self._side_lobe = SIDE_LOBE
        self._partials_max = parameters.partials_max
        self._turn, self._table = _window_tables(spectrum, bins)
        self._scratch = np.zeros(SCRATCH_A_BIN * bins)

    def all_principal(self, spectra: ComplexArray) -> Principals:
        """Return everything with r > C_th in each row of (rows, columns), nothing left out."""
        return self._find(spectra, 0.0, max(1, self._bins // 2))

    def strongest(self, spectra: ComplexArray) -> Principals:
        """Return what the live form plays of each row of (rows, columns), at most n a row.

        A loud tone's side lobes can pass r > C_th now and then. Their own vibration is 80 dB
        down, but each takes its share of P_k from the tone, which then flutters by a percent: so
        what stands 40 dB under a row's highest is left out. Of more than n then the n with the
        largest r are kept; of equals the lower frequency. Called on the audio thread.

        Raises
        ------
        TypeError, ValueError
            spectra is no contiguous complex128 array of two dimensions and `bins` columns or more.
        """
        return self._find(spectra, self._side_lobe, self._partials_max)

    def _find(self, spectra: ComplexArray, side_lobe: float, most: int) -> Principals:
        room = len(spectra) * most
        row, found = np.empty(room, dtype=np.intp), np.empty((4, room))
        count = find(
            spectra,
            self._table,
            self._turn,
            self._bins,
            self._first,
            self._last,
            self._bin_hz,
            self._threshold_hz,
            self._peak_span_min,
            self._weakest_image,
            side_lobe,
            most,
            self._scratch,
            row,
            found,
        )
        return Principals(row[:count], *found[:, :count])


def _window_tables(spectrum: Spectrum, bins: int) -> tuple[FloatArray, FloatArray]:
    """Return what images are computed from: the turn of each low bin, the window's spectrum.

    Phases counted from the window's centre make the window's spectrum real; bins turn by a cosine
    and a sine each, (2, low bins + `NEIGHBOURS`). The spectrum, 1 at 0, has `TABLE_BINS_A_BIN`
    entries a bin.
    """
    frames, length = spectrum.window_frames, spectrum.fft_length
    # An image is looked up at the sum of two frequencies, which the table must reach, and
    # neighbours must lie within the spectra.
    room = min(spectrum.bins // 2, bins) - 1 - NEIGHBOURS
    low_bins = max(0, min(int(IMAGE_REACH_WINDOWS * length / frames), room))
    turned_bins = np.arange(low_bins + NEIGHBOURS if low_bins else 0)
    turn = 2.0 * np.pi * turned_bins * (frames / 2) / length
    # Its lowest part alone, on a grid that much finer than a bin.
    entries = TABLE_BINS_A_BIN * 2 * turn.shape[-1] + 2
    fine_length = TABLE_BINS_A_BIN * length
    fine = zoom_fft(hamming(frames, sym=False), (0, entries), entries, fs=fine_length)
    turned = fine * np.exp(2j * np.pi * np.arange(entries) * (frames / 2) / fine_length)
    return np.stack((np.cos(turn), np.sin(turn))), turned.real / turned[0].real

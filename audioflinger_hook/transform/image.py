"""Low tones cleared of their own image: the half of a real tone at negative frequency.

Within a few window bandwidths of 0 Hz a peak stands on the far side lobes of its own image. They
pull it to and fro as its phase turns: at 55 Hz by 4 Hz of audio, which is felt as a wobble. The
image is known from the peak itself, so it is computed and taken away.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft
from scipy.signal.windows import hamming

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum, magnitude

REACH_WINDOWS = 28.0
"""Peaks below this many times 1/T (600 Hz) are cleared; over it the image is under -60 dB."""

TABLE_BINS_A_BIN = 64
"""Entries a bin: the nearest one is within 1.3 % of a side lobe, 38 dB under the image itself."""


class ImageRemoval:
    """Removes from amplitude spectra what the images of strong low peaks add to low bins.

    Pure: holds the window's own spectrum as a table. Not part of the reference form.
    """

    def __init__(self, spectrum: Spectrum, weakest: float) -> None:
        """weakest: amplitude under which a peak is left as it is."""
        self._weakest = weakest
        frames, length = spectrum.window_frames, spectrum.fft_length
        self._low_bins = min(int(REACH_WINDOWS * length / frames), spectrum.bins // 2)
        self._bins = np.arange(self._low_bins + 1.0)
        # Phases counted from the window's centre make the window's spectrum real.
        self._centre = np.exp(2j * np.pi * self._bins * (frames / 2) / length)
        # The padded transform of the window is its spectrum on a grid as fine as wished.
        fine = rfft(hamming(frames, sym=False), TABLE_BINS_A_BIN * length)
        fine = fine[: TABLE_BINS_A_BIN * (2 * self._low_bins + 4)]
        bins = np.arange(fine.size) / TABLE_BINS_A_BIN
        turned = fine * np.exp(2j * np.pi * bins * (frames / 2) / length)
        self._table: FloatArray = turned.real / turned[0].real

    def clear(self, spectra: ComplexArray, amplitude: FloatArray) -> None:
        """Rewrite the low bins of amplitude (rows, bins) from spectra (rows, bins or more)."""
        top = self._low_bins
        low = amplitude[:, : top + 1]
        middle = low[:, 1:-1]
        row, peak = (
            (middle > low[:, :-2]) & (middle >= low[:, 2:]) & (middle > self._weakest)
        ).nonzero()
        if not row.size:
            return
        at = low[row, peak + 1]
        before, after = low[row, peak], low[row, peak + 2]
        offset = 0.5 * (before - after) / (before - 2.0 * at + after)
        centre = peak + 1 + offset
        centred = spectra[:, : top + 1] * self._centre
        tone = centred[row, peak + 1] / self._window_at(np.abs(offset))
        image = tone.conj()[:, None] * self._window_at(self._bins + centre[:, None])
        np.subtract.at(centred, row, image)
        low[:, :] = magnitude(centred)

    def _window_at(self, distance_bins: FloatArray) -> FloatArray:
        """Return the window's real spectrum, 1 at 0, to the nearest entry of the table."""
        nearest: FloatArray = self._table[(distance_bins * TABLE_BINS_A_BIN + 0.5).astype(np.intp)]
        return nearest

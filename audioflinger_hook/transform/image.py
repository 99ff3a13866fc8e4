"""Low tones cleared of their own image: the half of a real tone at negative frequency.

A peak stands on the far side lobes of its own image, which a Hamming window lets fall off slowly.
They pull it to and fro as its phase turns: at 55 Hz by 4 Hz of audio, and wherever the hop nearly
keeps step with the tone so slowly that it is felt as a wobble. The image is known from the peak
itself, so it is computed and taken away.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft
from scipy.signal.windows import hamming

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.principal import parabola
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum

REACH_WINDOWS = 75.0
"""Peaks below this many times 1/T (1.6 kHz) are cleared; from there the image is about -70 dB."""

NEIGHBOURS = np.arange(-7, 8)
"""Bins around a peak that are cleared: its main lobe and the half-power walk on it."""

TABLE_BINS_A_BIN = 32
"""Entries a bin: between them a straight line is within 0.2 % of a side lobe."""


class ImageRemoval:
    """Removes from amplitude spectra what the images of strong low peaks add around them.

    Pure: holds the window's own spectrum as a table. Not part of the reference form.
    """

    def __init__(self, spectrum: Spectrum, bins: int, weakest: float) -> None:
        """bins: columns of the spectra; weakest: amplitude under which a peak is left alone."""
        self._weakest = weakest
        frames, length = spectrum.window_frames, spectrum.fft_length
        # An image is looked up at the sum of two frequencies, which the table must reach, and
        # neighbours must lie within the spectra.
        room = min(spectrum.bins // 2 - 1, bins - 1) - int(NEIGHBOURS[-1])
        self._low_bins = max(0, min(int(REACH_WINDOWS * length / frames), room))
        # Phases counted from the window's centre make the window's spectrum real.
        turn = 2.0 * np.pi * np.arange(self._low_bins + 1 + NEIGHBOURS[-1]) * (frames / 2) / length
        self._cosine, self._sine = np.cos(turn), np.sin(turn)
        # The padded transform of the window is its spectrum on a grid as fine as wished.
        fine = rfft(hamming(frames, sym=False), TABLE_BINS_A_BIN * length)
        fine = fine[: TABLE_BINS_A_BIN * 2 * self._cosine.size + 2]
        entries = np.arange(fine.size) / TABLE_BINS_A_BIN
        turned = fine * np.exp(2j * np.pi * entries * (frames / 2) / length)
        self._table: FloatArray = turned.real / turned[0].real

    def clear(self, spectra: ComplexArray, amplitude: FloatArray) -> None:
        """Rewrite the low bins of amplitude (rows, bins) from spectra (rows, bins)."""
        low = amplitude[:, : self._low_bins + 1]
        middle = low[:, 1:-1]
        row, before_peak = (
            (middle > low[:, :-2]) & (middle >= low[:, 2:]) & (middle > self._weakest)
        ).nonzero()
        if not row.size:
            return
        peak = before_peak + 1
        offset, _ = parabola(low[row, before_peak], low[row, peak], low[row, peak + 1])

        # In real arithmetic: a complex product rounds by where in the array its factors stand.
        cosine, sine = self._cosine[peak], self._sine[peak]
        real, imaginary = spectra.real[row, peak], spectra.imag[row, peak]
        height = self._window_at(np.abs(offset))
        tone_real = ((real * cosine - imaginary * sine) / height)[:, None]
        tone_imaginary = ((real * sine + imaginary * cosine) / height)[:, None]

        # Where neighbourhoods of peaks overlap, in the valley between, the upper one's stands.
        bins = np.maximum(peak[:, None] + NEIGHBOURS, 0)
        cosine, sine = self._cosine[bins], self._sine[bins]
        rows = row[:, None]
        real, imaginary = spectra.real[rows, bins], spectra.imag[rows, bins]
        # The image is the tone's conjugate, on the window's spectrum around minus its frequency.
        image = self._window_at(bins + (peak + offset)[:, None])
        real, imaginary = (
            real * cosine - imaginary * sine - tone_real * image,
            real * sine + imaginary * cosine + tone_imaginary * image,
        )
        amplitude[rows, bins] = np.sqrt(real * real + imaginary * imaginary)

    def _window_at(self, distance_bins: FloatArray) -> FloatArray:
        """Return the window's real spectrum, 1 at 0, between the entries of the table."""
        position = distance_bins * TABLE_BINS_A_BIN
        below = position.astype(np.intp)
        here = self._table[below]
        value: FloatArray = here + (position - below) * (self._table[below + 1] - here)
        return value

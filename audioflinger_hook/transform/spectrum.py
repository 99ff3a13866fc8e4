"""Amplitude spectra of windows: periodic Hamming, zero-padded, a full-scale sine has A = 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters

ComplexArray = NDArray[np.complex128]


class Spectrum:
    """Spectra at one samplerate; pure, holds only its window.

    samplerate (Hz), window_frames (N), fft_length (NFFT), bins (NFFT/2 + 1) and bin_hz describe
    its grid.
    """

    def __init__(self, parameters: TransformParameters, samplerate: int) -> None:
        self.samplerate = samplerate
        self.window_frames = parameters.window_frames(samplerate)
        self.fft_length = parameters.fft_length(samplerate)
        self.bins = self.fft_length // 2 + 1
        self.bin_hz = samplerate / self.fft_length
        phase = 2.0 * np.pi * np.arange(self.window_frames) / self.window_frames
        hamming = 0.54 - 0.46 * np.cos(phase)
        self._window = hamming * (2.0 / hamming.sum())

    def transform(self, windows: FloatArray) -> ComplexArray:
        """Return 2 X[k] / sum(w) of each row: (rows, N) to (rows, bins), complex128.

        Each row of the batch is transformed by itself: its bytes do not depend on its company.
        """
        return np.asarray(rfft(windows * self._window, self.fft_length, axis=1))


def magnitude(spectra: ComplexArray) -> FloatArray:
    """Return |X| of any shape, without the overflow guard of `abs`, which costs three times it."""
    squares: FloatArray = spectra.real**2
    squares += spectra.imag**2
    return np.sqrt(squares, out=squares)

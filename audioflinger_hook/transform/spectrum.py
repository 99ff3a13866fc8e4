"""Amplitude spectra of windows: periodic Hamming, zero-padded, a full-scale sine has A = 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from audioflinger_hook.transform.arrays import ComplexArray, FloatArray
from audioflinger_hook.transform.parameters import TransformParameters


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

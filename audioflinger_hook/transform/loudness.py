"""How loud a window is heard: its energy weighed as ITU-R BS.1770 weighs it, over the bins."""

from __future__ import annotations

import math

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum

SHELF_HZ, SHELF_Q, SHELF_DB, SHELF_MIDDLE = 1681.974450955533, 0.7071752369554196, 4.0, 0.4996667741
HIGH_PASS_HZ, HIGH_PASS_Q = 38.13547087602444, 0.5003270373238773
"""The analogue filters whose digital form at 48 kHz is what BS.1770-4 prints (K-weighting)."""

LEVEL_AT_HZ = 1_000.0
"""A full-scale tone of this frequency has a loudness of 0 dB here: 3.01 dB over its LKFS."""

NOTHING = 1e-20
"""Energy under which a window counts as -200 dB: no logarithm of 0."""


def k_weight(audio_hz: FloatArray) -> FloatArray:
    """Return the factor of K-weighting on energy at frequencies in Hz, 1 at 1 kHz, any shape.

    Magnitudes of the analogue filters: the same at every samplerate.
    """
    return _weight(audio_hz) / _weight(np.array(LEVEL_AT_HZ))


def _weight(audio_hz: FloatArray) -> FloatArray:
    s = 1j * audio_hz / SHELF_HZ
    high = 10.0 ** (SHELF_DB / 20.0)
    shelf = (high * s * s + high**SHELF_MIDDLE * s / SHELF_Q + 1.0) / (s * s + s / SHELF_Q + 1.0)
    s = 1j * audio_hz / HIGH_PASS_HZ
    high_pass = s * s / (s * s + s / HIGH_PASS_Q + 1.0)
    weight: FloatArray = np.abs(shelf * high_pass) ** 2
    return weight


def bin_weights(spectrum: Spectrum, bins: int) -> FloatArray:
    """Return what the squared magnitude of each of the first bins counts, (bins,).

    The sum over a tone's bins is its squared amplitude, times `k_weight`.
    """
    window = spectrum._window
    # By Parseval: what a tone's energy is spread over, in bins.
    spread = spectrum.fft_length * float((window * window).sum()) / float(window.sum()) ** 2
    bin_hz = spectrum.bin_hz * np.arange(bins, dtype=np.float64)
    weights: FloatArray = k_weight(bin_hz) / spread
    return weights


def loudness_db(spectra: ComplexArray, weights: FloatArray) -> list[float]:
    """Return the loudness of each row of (rows, columns) in dB, a full-scale tone of 1 kHz at 0.

    Row by row, so that no row's sum depends on its company.
    """
    looked_at = spectra[:, : weights.size]
    return [
        10.0 * math.log10(max(NOTHING, float(np.add.reduce(weights * (x.real**2 + x.imag**2)))))
        for x in looked_at
    ]

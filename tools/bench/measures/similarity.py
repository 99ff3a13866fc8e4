"""Similarity of a vibration to its sound, and of two vibrations. Signals are mono, (frames,)."""

from __future__ import annotations

import numpy as np
from scipy.signal.windows import hann

from audioflinger_hook.transform import FloatArray

DELAY_MAX_S = 0.1
ENVELOPE_FRAME_S = 0.01

FELT_HZ = (15.0, 250.0)
FELT_BANDS = 24
NOTHING_DB = -60.0  # dB relative to a full-scale sine; a weaker vibration counts as silence


def envelope_correlation(sound: FloatArray, vibration: FloatArray, samplerate: int) -> float:
    """Return the Pearson correlation of the levels of sound and vibration; NaN for a steady sound.

    A level is the r.m.s. of 10 ms. The latency of a method may be unknown, so the result is the
    largest correlation for delays of the vibration from 0 to 0.1 s.
    """
    heard, felt = (_pieces_rms(signal, samplerate) for signal in (sound, vibration))
    if heard.size < 3 or not heard.std() > 0.0:
        return float("nan")
    if not felt.any():
        return 0.0
    coefficients = []
    for late in range(1 + round(DELAY_MAX_S / ENVELOPE_FRAME_S)):
        then, now = heard[: heard.size - late], felt[late:]
        if then.size < 3 or not then.std() > 0.0 or not now.std() > 0.0:
            break
        coefficients.append(float(np.corrcoef(then, now)[0, 1]))
    return max(coefficients, default=0.0)


def felt_spectrum(vibration: FloatArray, samplerate: int) -> tuple[FloatArray, FloatArray]:
    """Return the frequencies from 15 to 250 Hz, and the mean square of the vibration at each."""
    window = hann(vibration.size, sym=False)
    window /= float(np.sqrt(np.mean(window**2)))
    spectrum = np.fft.rfft(vibration * window) / vibration.size
    power: FloatArray = np.asarray(2.0 * np.abs(spectrum) ** 2, np.float64)
    hz: FloatArray = np.arange(power.size, dtype=np.float64) * (samplerate / vibration.size)
    felt = (hz >= FELT_HZ[0]) & (hz <= FELT_HZ[1])
    return hz[felt], power[felt]


def spectral_distance(one: FloatArray, other: FloatArray, samplerate: int) -> float | None:
    """Return the difference between the spectra of two vibrations, from 0 (equal) to 1.

    The energy of each vibration is summed in 24 bands of equal width from 15 to 250 Hz, and
    normalised to a sum of 1. The result is half of the summed absolute differences. It is None if a
    vibration is weaker than -60 dB relative to a full-scale sine.
    """
    shares = []
    for vibration in (one, other):
        hz, power = felt_spectrum(vibration, samplerate)
        if level_db(power.sum()) > NOTHING_DB:
            bands = np.histogram(hz, FELT_BANDS, FELT_HZ, weights=power)[0]
            shares.append(bands / bands.sum())
    return float(0.5 * np.abs(shares[0] - shares[1]).sum()) if len(shares) == 2 else None


def level_db(mean_square: float) -> float:
    """Convert a mean square to dB relative to a full-scale sine; -inf for 1e-20 or less."""
    return 10.0 * float(np.log10(2.0 * mean_square)) if mean_square > 1e-20 else -float("inf")


def _pieces_rms(signal: FloatArray, samplerate: int) -> FloatArray:
    frames = round(ENVELOPE_FRAME_S * samplerate)
    pieces = signal[: signal.size - signal.size % frames].reshape(-1, frames)
    rms: FloatArray = np.sqrt((pieces**2).mean(axis=1))
    return rms

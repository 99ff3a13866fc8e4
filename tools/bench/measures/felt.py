"""Strength of a vibration as a seated person perceives it.

A vibration is an acceleration, (frames,), with full scale ±1.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter, sosfilt

from audioflinger_hook.transform import FloatArray
from device.drive.exposure import PARTS, wk_sections

BAND_LIMIT_HZ = 100.0  # upper band limit of Wk, which limits the measurement, not the sensation
RUNNING_S = 0.125  # time constant of the running r.m.s., ISO 2631-1, equation (3)
STEPS_A_SECOND = 1_000
EXCEEDED = 0.05  # share of time in which a level is exceeded, like N5 for loudness
TAIL_S = 0.25  # time in s after a sound that still belongs to the sound
NOTHING_DB = -70.0
"""Lowest level in dB relative to a full-scale sine, and level of all weaker vibration. An
80 Hz tone at 54 dB below full scale has this level after the weighting.
"""

_FELT_PARTS = [part[2] != BAND_LIMIT_HZ for part in PARTS]


def seat_weight(vibration_hz: FloatArray) -> FloatArray:
    """Return the relative perceived strength of vertical seat acceleration, by frequency in Hz.

    This is the weighting Wk of ISO 2631-1:1997, annex A, without its upper band limit of 100 Hz.
    Above 12.5 Hz, the weighting falls by 6 dB an octave, so perceived strength is proportional to
    velocity. Measured contours of equal comfort agree with this (Griffin, Whitham and Parsons,
    Ergonomics 25, 1982).
    """
    s = 2j * np.pi * np.asarray(vibration_hz, dtype=np.float64)
    response = np.ones_like(s)
    for (numerator, denominator, _), counts in zip(PARTS, _FELT_PARTS, strict=True):
        if counts:
            response *= np.polyval(numerator, s) / np.polyval(denominator, s)
    return np.abs(response)


def weighted(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return the vibration filtered with the weighting of `seat_weight`, (frames,)."""
    felt: FloatArray = sosfilt(wk_sections(samplerate)[_FELT_PARTS], vibration)
    return felt


def running_db(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return the running r.m.s. level for each ms, in dB relative to a full-scale sine.

    The averaging time constant is 125 ms.

    samplerate: in Hz, a multiple of 1000.
    """
    step = samplerate // STEPS_A_SECOND
    whole = vibration[: vibration.size // step * step].reshape(-1, step)
    kept = np.exp(-1.0 / (RUNNING_S * STEPS_A_SECOND))
    mean_square = lfilter([1.0 - kept], [1.0, -kept], np.einsum("ij,ij->i", whole, whole) / step)
    level: FloatArray = 10.0 * np.log10(2.0 * mean_square + 1e-20)
    return level


def felt_db(running: FloatArray) -> float:
    """Return the level in dB that `running` exceeds 5 % of the time, at least -70.

    running: levels in dB, one for each ms.
    """
    return max(NOTHING_DB, float(np.percentile(running, 100.0 * (1.0 - EXCEEDED))))

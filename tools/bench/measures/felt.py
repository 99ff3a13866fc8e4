"""How strongly a seated body feels a vibration: by its frequency, and as a level over time.

A vibration is (frames,) at full scale +-1 and counts as acceleration. No level here depends on the
delay of the vibration.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter, sosfilt

from audioflinger_hook.transform import FloatArray
from device.drive.exposure import PARTS, wk_sections

BAND_LIMIT_HZ = 100.0
"""The upper band limit in Wk: of what is measured, not of what is felt."""

RUNNING_S = 0.125
"""Time constant of the running r.m.s., as of ISO 2631-1, equation (3); that of "fast" in sound."""

STEPS_A_SECOND = 1_000

EXCEEDED = 0.05
"""Share of the time in which a level is exceeded, as of N5 in loudness."""
TAIL_S = 0.25
"""What follows a sound counts for that long."""

NOTHING_DB = -70.0
"""Weaker vibration counts as this strong: an unweighted 80 Hz tone of 54 dB under full scale."""

_FELT_PARTS = [part[2] != BAND_LIMIT_HZ for part in PARTS]


def seat_weight(vibration_hz: FloatArray) -> FloatArray:
    """Return how strongly a seat's vertical acceleration is felt at each frequency in Hz.

    Wk of ISO 2631-1:1997, annex A, without its upper band limit of 100 Hz. Above 12.5 Hz
    sensitivity falls by 6 dB an octave, at constant velocity, as the contours of equal comfort do
    (Griffin, Whitham and Parsons, Ergonomics 25, 1982).
    """
    s = 2j * np.pi * np.asarray(vibration_hz, dtype=np.float64)
    response = np.ones_like(s)
    for (numerator, denominator, _), counts in zip(PARTS, _FELT_PARTS, strict=True):
        if counts:
            response *= np.polyval(numerator, s) / np.polyval(denominator, s)
    return np.abs(response)


def weighted(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return the vibration filtered by `seat_weight`, (frames,)."""
    felt: FloatArray = sosfilt(wk_sections(samplerate)[_FELT_PARTS], vibration)
    return felt


def running_db(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return the running level in dB at the end of every ms, a steady full-scale sine at 0.

    samplerate: Hz, a multiple of 1000.
    """
    step = samplerate // STEPS_A_SECOND
    whole = vibration[: vibration.size // step * step].reshape(-1, step)
    kept = np.exp(-1.0 / (RUNNING_S * STEPS_A_SECOND))
    mean_square = lfilter([1.0 - kept], [1.0, -kept], np.einsum("ij,ij->i", whole, whole) / step)
    level: FloatArray = 10.0 * np.log10(2.0 * mean_square + 1e-20)
    return level


def felt_db(running: FloatArray) -> float:
    """Return the level that `running_db` exceeds in a twentieth of the time, at least -70 dB."""
    return max(NOTHING_DB, float(np.percentile(running, 100.0 * (1.0 - EXCEEDED))))

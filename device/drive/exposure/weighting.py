"""The frequency weighting Wk of ISO 2631-1:1997, for vertical vibration of the seat.

It has four parts (annex A): band limits of second order at 0.4 and 100 Hz, the transition from
acceleration to velocity at 12.5 Hz, and the step up between 2.37 and 3.35 Hz.
"""

import math

import numpy as np
from scipy.signal import bilinear

from device.units import FloatArray

HIGHEST_HZ = 80.0
"""End of the standard's weighting; above it the same formula is an extrapolation."""


_Part = tuple[tuple[float, float, float], tuple[float, float, float], float]


def _w(frequency_hz: float) -> float:
    return math.tau * frequency_hz


def _second(frequency_hz: float, q: float) -> tuple[float, float, float]:
    """1 + s / (Q w) + s^2 / w^2, highest power first."""
    return (1.0 / _w(frequency_hz) ** 2, 1.0 / (q * _w(frequency_hz)), 1.0)


_BAND_Q = math.sqrt(0.5)
PARTS: tuple[_Part, ...] = (
    ((1.0 / _w(0.4) ** 2, 0.0, 0.0), _second(0.4, _BAND_Q), 0.4),
    ((0.0, 0.0, 1.0), _second(100.0, _BAND_Q), 100.0),
    ((0.0, 1.0 / _w(12.5), 1.0), _second(12.5, 0.63), 12.5),
    (
        tuple(c * (2.37 / 3.35) ** 2 for c in _second(2.37, 0.91)),  # type: ignore[assignment]
        _second(3.35, 0.91),
        math.sqrt(2.37 * 3.35),
    ),
)
"""Numerator, denominator (powers of s, highest first) and the frequency that stays exact."""


def wk_sections(samplerate: float) -> FloatArray:
    """Return Wk as second-order sections for `scipy.signal.sosfilt`, (4, 6), in float64.

    samplerate: Hz, 2000 or more. The bilinear transform is pre-warped, so that each part is exact
    at its frequency. Lower precision, or one polynomial, would lose poles as close to 1 as those of
    0.4 Hz.
    """
    sections = []
    for numerator, denominator, exact_hz in PARTS:
        # s / tan(...) instead of s T / 2: the bilinear transform at this rate, exact at exact_hz.
        rate = math.pi * exact_hz / math.tan(math.pi * exact_hz / samplerate)
        b, a = bilinear(numerator, denominator, fs=rate)
        sections.append(np.concatenate([np.pad(b, (0, 3 - len(b))), a]))
    return np.array(sections)

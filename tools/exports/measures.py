"""How near a rendered export is to the vibration it was made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks, hilbert

from device.units import FloatArray

ENVELOPE_S = 0.05
"""Length of the Hann window over power: swings above about 20 Hz are left out."""

ONSET_WINDOW_S = 0.012
ONSET_SHARE = 0.15
"""An onset raises the short envelope by this share of its largest value, ..."""

ONSET_FROM = 0.3
"""... from at most this share of its level afterwards: what swells or beats is none."""

ONSETS_APART_S = 0.08
ONSET_REACH_S = 0.025


@dataclass(frozen=True)
class Likeness:
    """Correlation of the envelopes, and the time of each onset against the original, in ms."""

    envelope: float
    onset_errors_ms: tuple[float, ...]


def likeness(original: FloatArray, made: FloatArray, rate_hz: int) -> Likeness:
    """Compare two vibrations of one length, (frames,)."""
    ours, theirs = (envelope(one, rate_hz, ENVELOPE_S) for one in (original, made))
    if np.ptp(ours) and np.ptp(theirs):
        correlation = float(np.corrcoef(ours, theirs)[0, 1])
    else:
        correlation = float(np.ptp(ours) == np.ptp(theirs))
    return Likeness(correlation, onset_errors_ms(original, made, rate_hz))


def envelope(vibration: FloatArray, rate_hz: int, window_s: float) -> FloatArray:
    """Return the r.m.s. of the analytic signal under a Hann window of this length."""
    length = 2 * round(0.5 * window_s * rate_hz) + 1
    window = np.hanning(length + 2)[1:-1]
    power = np.abs(hilbert(vibration)) ** 2
    smooth = np.convolve(power, window / window.sum())[length // 2 :][: power.size]
    return np.sqrt(np.maximum(smooth, 0.0))


def onset_errors_ms(original: FloatArray, made: FloatArray, rate_hz: int) -> tuple[float, ...]:
    """Return for each onset of the original how much later the other one rises, in ms."""
    ours, theirs = (_rises(one, rate_hz) for one in (original, made))
    short = envelope(original, rate_hz, ONSET_WINDOW_S)
    reach = round(ONSET_REACH_S * rate_hz)
    half = round(0.5 * ONSET_WINDOW_S * rate_hz)
    peaks, _ = find_peaks(
        ours, height=ONSET_SHARE * short.max(initial=0.0), distance=round(ONSETS_APART_S * rate_hz)
    )
    errors = []
    for place in peaks.tolist():
        after = short[place : place + 2 * half + 1].max()
        if short[max(0, place - half)] > ONSET_FROM * after:
            continue
        first = max(0, place - reach)
        found = first + int(theirs[first : place + reach + 1].argmax())
        errors.append(1e3 * (found - place) / rate_hz)
    return tuple(errors)


def _rises(vibration: FloatArray, rate_hz: int) -> FloatArray:
    """Return by how much the short envelope rises around each frame."""
    short = envelope(vibration, rate_hz, ONSET_WINDOW_S)
    half = round(0.5 * ONSET_WINDOW_S * rate_hz)
    padded = np.pad(short, (half, half), constant_values=(0.0, short[-1]))
    return padded[2 * half :] - padded[: -2 * half]

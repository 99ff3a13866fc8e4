"""How soon an impact is at its strength: envelopes, halves of peaks and peaks. Pure functions.

Signals are (frames,) at full scale +-1. Times are in s; sound and vibration begin together, so that
the latency of the vibration counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import butter, hilbert, sosfiltfilt

from audioflinger_hook.transform import FloatArray

ENVELOPE_HZ = 60.0
"""Corner of the zero-phase low-pass of envelopes, as in `vibration.onset_lag_s`."""

PEAK_WITHIN_S = 0.15
"""The peak of a vibration is looked for until that long after the peak of its sound."""


def envelope(signal: FloatArray, samplerate: int, corner_hz: float = ENVELOPE_HZ) -> FloatArray:
    """Return the magnitude of the analytic signal, low-passed without phase, 0 or more."""
    analytic = hilbert(signal, next_fast_len(signal.size))[: signal.size]
    low_pass = butter(2, corner_hz, fs=samplerate, output="sos")
    smooth: FloatArray = np.maximum(sosfiltfilt(low_pass, np.abs(analytic)), 0.0)
    return smooth


@dataclass(frozen=True)
class Attack:
    """An impact's vibration behind its sound: half of the peak, and the peak, in s."""

    half_lag_s: float
    peak_lag_s: float


def attack(
    sound: FloatArray, vibration: FloatArray, samplerate: int, at_s: float = 0.0
) -> Attack | None:
    """Return how long after its sound an impact's vibration is at half of its peak, and at it.

    Half of the peak is counted from what there was before: the mean envelope of 0.1 s before
    `at_s`, where the impact begins. None where sound or vibration does not rise to twice that.
    """
    first = round(at_s * samplerate)
    heard, felt = (envelope(signal, samplerate) for signal in (sound, vibration))
    peak = first + int(heard[first:].argmax())
    until = peak + round(PEAK_WITHIN_S * samplerate)
    times = [_half_and_peak(each[:until], first, samplerate) for each in (heard, felt)]
    if times[0] is None or times[1] is None:
        return None
    (heard_half, heard_peak), (felt_half, felt_peak) = times
    return Attack((felt_half - heard_half) / samplerate, (felt_peak - heard_peak) / samplerate)


def _half_and_peak(level: FloatArray, first: int, samplerate: int) -> tuple[int, int] | None:
    """Return the frames of the first half of the peak and of the peak after `first`."""
    before = level[max(0, first - round(0.1 * samplerate)) : first]
    base = float(before.mean()) if before.size else 0.0
    peak = first + int(level[first:].argmax())
    if not level[peak] > max(2.0 * base, 1e-6):
        return None
    half = base + 0.5 * (float(level[peak]) - base)
    return first + int((level[first:] >= half).argmax()), peak

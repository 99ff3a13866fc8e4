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

ONSET_SHARE = 0.1
"""An impact begins where its envelope first has this share of its greatest value."""
IMPACT_S = 0.15
"""Its peak is the greatest value within that time: what strikes again later is another impact."""
LATER_S = 0.06
"""The peak of the vibration may be that much later."""
SUDDEN_S, OVER_AFTER_S, OVER_SHARE, AGAIN_SHARE = 0.05, 0.1, 0.6, 1.3
"""What makes a sound an impact, see `is_impact`."""


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


def attack(sound: FloatArray, vibration: FloatArray, samplerate: int, at_s: float) -> Attack | None:
    """Return how far the vibration of a sound's first impact is behind it; None if not felt.

    Half of a peak is counted from the mean envelope of 0.1 s before `at_s`, after which the impact
    begins. It is felt if its vibration rises to twice that mean and over -80 dB of full scale.
    """
    first = round(at_s * samplerate)
    heard, felt = (envelope(signal, samplerate) for signal in (sound, vibration))
    onset = onset_frame(heard, samplerate, at_s)
    end = onset + round(IMPACT_S * samplerate)
    heard_half, heard_peak, _ = _half_and_peak(heard[:end], first, samplerate)
    later = end + round(LATER_S * samplerate)
    felt_half, felt_peak, rises = _half_and_peak(felt[:later], first, samplerate)
    if not rises:
        return None
    return Attack((felt_half - heard_half) / samplerate, (felt_peak - heard_peak) / samplerate)


def is_impact(sound: FloatArray, samplerate: int, *, brief: bool) -> bool:
    """Return whether a sound begins suddenly, at half of its first peak within 50 ms of its onset.

    brief: whether it has to be one stroke, too: from 100 to 150 ms after its onset less than 0.6
    of the peak on average, and nothing much stronger later.
    """
    heard = envelope(sound, samplerate)
    onset = onset_frame(heard, samplerate, 0.0)
    end = onset + round(IMPACT_S * samplerate)
    half, peak, _ = _half_and_peak(heard[:end], 0, samplerate)
    top = float(heard[peak])
    rest = float(heard[onset + round(OVER_AFTER_S * samplerate) : end].sum()) / samplerate
    over = rest < OVER_SHARE * top * (IMPACT_S - OVER_AFTER_S)
    once = float(heard.max()) < AGAIN_SHARE * top
    return half - onset <= SUDDEN_S * samplerate and (not brief or (over and once))


def onset_frame(level: FloatArray, samplerate: int, at_s: float) -> int:
    """Return the frame after `at_s` where an envelope first rises by a tenth of what it will."""
    first = round(at_s * samplerate)
    base = _base(level, first, samplerate)
    rise = ONSET_SHARE * (float(level[first:].max()) - base)
    return first + int((level[first:] >= base + rise).argmax())


def _base(level: FloatArray, first: int, samplerate: int) -> float:
    before = level[max(0, first - round(0.1 * samplerate)) : first]
    return float(before.mean()) if before.size else 0.0


def _half_and_peak(level: FloatArray, first: int, samplerate: int) -> tuple[int, int, bool]:
    """Return the frames of half of the peak and of the peak after `first`, and if it stands out."""
    base = _base(level, first, samplerate)
    peak = first + int(level[first:].argmax())
    half = base + 0.5 * (float(level[peak]) - base)
    reached = first + int((level[first:] >= half).argmax())
    return reached, peak, float(level[peak]) > max(2.0 * base, 1e-4)

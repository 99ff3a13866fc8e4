"""Delay from the sound of an impact to its vibration.

An impact is a sound with a sudden start. Signals are (frames,) with full scale ±1. Delays include
the latency of the vibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import butter, hilbert, sosfiltfilt

from audioflinger_hook.transform import FloatArray

ENVELOPE_HZ = 60.0  # cut-off of the zero-phase low-pass of envelopes
ONSET_SHARE = 0.1  # an impact starts when its envelope first reaches this share of its rise
IMPACT_S = 0.15  # time in s after the onset that contains the impact's peak
LATER_S = 0.06  # time in s after IMPACT_S in which the vibration may still reach its peak
SUDDEN_S, OVER_AFTER_S, OVER_SHARE, AGAIN_SHARE = 0.05, 0.1, 0.6, 1.3


def envelope(signal: FloatArray, samplerate: int, corner_hz: float = ENVELOPE_HZ) -> FloatArray:
    """Return the envelope: the magnitude of the analytic signal after a zero-phase low-pass."""
    analytic = hilbert(signal, next_fast_len(signal.size))[: signal.size]
    low_pass = butter(2, corner_hz, fs=samplerate, output="sos")
    smooth: FloatArray = np.maximum(sosfiltfilt(low_pass, np.abs(analytic)), 0.0)
    return smooth


@dataclass(frozen=True)
class Attack:
    """Delays in s from the sound of an impact to its vibration.

    half_lag_s: delay between the times at which the two envelopes reach half of their peaks.
    peak_lag_s: delay between the peaks of the two envelopes.
    """

    half_lag_s: float
    peak_lag_s: float


def attack(sound: FloatArray, vibration: FloatArray, samplerate: int, at_s: float) -> Attack | None:
    """Return the delays of the first impact after `at_s`; None for an imperceptible vibration.

    Half of a peak is halfway between the peak and the mean envelope of the 0.1 s before `at_s`. A
    vibration is perceptible if the peak of its envelope exceeds twice this mean and -80 dB relative
    to full scale.
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
    """Return whether the envelope of a sound reaches half of its peak within 50 ms of the onset.

    The peak is the maximum until 150 ms after the onset.

    brief: whether two more conditions must be met. The mean of the envelope from 100 to 150 ms
        after the onset is below 0.6 of the peak. The maximum of the whole envelope is below 1.3
        times the peak.
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
    """Return the first frame after `at_s` at which an envelope reaches a tenth of its rise.

    The rise is the maximum after `at_s` minus the mean of the 0.1 s before `at_s`.
    """
    first = round(at_s * samplerate)
    base = _base(level, first, samplerate)
    rise = ONSET_SHARE * (float(level[first:].max()) - base)
    return first + int((level[first:] >= base + rise).argmax())


def _base(level: FloatArray, first: int, samplerate: int) -> float:
    before = level[max(0, first - round(0.1 * samplerate)) : first]
    return float(before.mean()) if before.size else 0.0


def _half_and_peak(level: FloatArray, first: int, samplerate: int) -> tuple[int, int, bool]:
    base = _base(level, first, samplerate)
    peak = first + int(level[first:].argmax())
    half = base + 0.5 * (float(level[peak]) - base)
    reached = first + int((level[first:] >= half).argmax())
    return reached, peak, float(level[peak]) > max(2.0 * base, 1e-4)

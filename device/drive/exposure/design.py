"""The exposure meter as numbers and tables: what the core's meter (exposure.c) works by."""

from __future__ import annotations

import math

import numpy as np
import scipy

from device.drive.exposure.dose import CAPS, HIGHEST_HZ, RUNNING_S, DoseSums, wk_sections
from device.errors import UsageError
from device.rig import Rig
from device.rig.actuator import motion_filter
from device.rig.equations import seat_sections
from device.units import FloatArray, Records

_LOWEST_HZ = 6_000
"""Least rate of the actuator model and Wk: linear interpolation then loses 0.06 % at 80 Hz and
0.5 % at 220 Hz."""
_READING_S = 0.01
"""Time between two gains of the cap: in it, no drive adds much to the dose."""
_ON_ITS_WAY = 1e-5
"""Share of a cap that is kept for the drive that has left when the gain is found."""
_RINGS_S = 5.0
"""Length of an impulse response; the rest is negligible."""

_LENGTHS = 6
_KAISER_BETA = 8.0
"""80 dB down at the frequencies that alias onto the vibration."""


def exposure_records(rig: Rig, samplerate: int, cap: str = "off") -> Records:
    """Return the design of a rig's exposure meter, by name; see `ExposureDesign` of the core.

    The meter predicts the acceleration of the seat from the drive, weights it by Wk and adds it up.
    If the rig does not describe its seat, the seat is taken to move like the moving mass.

    rig: the driven rig. samplerate: Hz, 6000 or more. cap: one of `CAPS`.
    UsageError: the rate is too low.
    """
    if samplerate < _LOWEST_HZ:
        raise UsageError(f"samplerate={samplerate} Hz is too low; choose {_LOWEST_HZ} Hz or more")
    factor = samplerate // _LOWEST_HZ
    rate = samplerate / factor
    decimation = decimation_taps(factor)
    motion, motion_fir = _motion(rig, rate)
    weighting = wk_sections(rate)
    above = scipy.signal.butter(4, HIGHEST_HZ, "highpass", fs=rate, output="sos")
    a8_m_s2, vdv = ((1.0 - _ON_ITS_WAY) * limit for limit in CAPS[cap] or (0.0, 0.0))
    return {
        "factor": factor,
        "decimation_taps": len(decimation),
        "motion_taps": len(motion_fir),
        "motion.count": len(motion),
        "weighting.count": len(weighting),
        "above.count": len(above),
        "reading_frames": factor * round(_READING_S * rate),
        # Symmetric, so that the order of the taps does not matter.
        "decimation": decimation,
        "motion.sections": motion,
        "motion_fir": motion_fir,
        "weighting.sections": weighting,
        "above.sections": np.asarray(above),
        "m_s2_per_full_scale": rig.dac.full_scale_v * rig.amplifier.gain,
        "period_s": 1.0 / rate,
        "running_share": -math.expm1(-1.0 / rate / RUNNING_S),
        "cap_a8_m_s2": a8_m_s2,
        "cap_vdv": vdv,
    }


def worst_second(rig: Rig, samplerate: int) -> DoseSums:
    """Return a bound on the dose that a second of any drive within full scale can add.

    The mean square is at most that of a sine where the response is largest; the peak is at most the
    sum of the impulse response's magnitudes. How much of it is above 80 Hz is not known: 0.
    """
    rate = samplerate / (samplerate // _LOWEST_HZ)
    motion, motion_fir = _motion(rig, rate)
    impulse = np.zeros(round(_RINGS_S * rate))
    impulse[0] = rig.dac.full_scale_v * rig.amplifier.gain
    response = scipy.signal.sosfilt(motion, impulse)
    if len(motion_fir):
        response = np.convolve(response, motion_fir)[: len(response)]
    response = scipy.signal.sosfilt(wk_sections(rate), response)
    largest = float(np.abs(np.fft.rfft(response)).max())
    peak = float(np.abs(response).sum())
    return DoseSums(1.0, largest**2, (largest * peak) ** 2)


def decimation_taps(factor: int) -> FloatArray:
    """Return the low-pass before every `factor`-th frame is kept: (taps,), symmetric.

    Up to a twentieth of the new rate its error is at most 1e-3, and aliases are 80 dB down.
    """
    if factor == 1:
        return np.ones(1)
    # The corner is half the new rate: only the low end is needed, so the slope may be wide.
    taps = scipy.signal.firwin(_LENGTHS * factor + 1, 1.0 / factor, window=("kaiser", _KAISER_BETA))
    return np.asarray(taps)


def _motion(rig: Rig, rate: float) -> tuple[FloatArray, FloatArray]:
    """Return sections and taps of the acceleration at the seat, m/s² per volt."""
    source = rig.amplifier.source_impedance_ohm
    if rig.seat:
        return seat_sections(rig.actuator, rig.seat, rate, source), np.empty(0)
    return motion_filter(rig.actuator, rate, source, "acceleration_m_s2")

"""The band of the target's actuator: 20-220 Hz is mapped to it in a straight line."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.exports.options import VIBRATION_HIGH_HZ, VIBRATION_LOW_HZ
from device.units import FloatArray


def to_device_hz(hz: FloatArray, band_hz: tuple[float, float] | None) -> FloatArray:
    """Return the frequencies that the device plays for frequencies of vibration.

    band_hz: lowest and highest frequency of the device; None: frequencies do not change.
    """
    if band_hz is None:
        return hz
    share = (hz - VIBRATION_LOW_HZ) / (VIBRATION_HIGH_HZ - VIBRATION_LOW_HZ)
    low_hz, high_hz = band_hz
    return low_hz + np.clip(share, 0.0, 1.0) * (high_hz - low_hz)


def band_text(band_hz: tuple[float, float] | None) -> str:
    """Return what a file says about the mapping."""
    if band_hz is None:
        return "frequencies are those of the vibration, 20-220 Hz"
    return f"20-220 Hz of vibration are mapped to {band_hz[0]:g}-{band_hz[1]:g} Hz of the device"

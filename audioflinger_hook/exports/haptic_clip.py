""".haptic 1.0.0 of Meta and Lofelt: envelopes of amplitude and frequency, with emphasis at onsets.

Limits: two points or more, in order of time; an emphasis is at least the envelope's amplitude at
its point. A player plays it as a pulse on top of the envelope.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from audioflinger_hook.exports.band import band_text
from audioflinger_hook.exports.envelope import Limits, envelope_of
from audioflinger_hook.exports.glides import VibrationCurve
from audioflinger_hook.exports.options import VIBRATION_HIGH_HZ, VIBRATION_LOW_HZ
from audioflinger_hook.exports.parametric import Composed, Job
from device.units import FloatArray

LIMITS = Limits(spacing_s=1 / 59, longest_s=2.0)
SHORTEST_S = 0.001
DECIMALS = 5


def compose(curve: VibrationCurve, duration_s: float, job: Job) -> tuple[bytes, Composed]:
    """Return the content of a .haptic file, and its errors."""
    envelope = envelope_of(curve, max(SHORTEST_S, duration_s), LIMITS)
    frequency = relative(envelope.hz)
    amplitude: list[dict[str, Any]] = [
        {"time": _rounded(at), "amplitude": _rounded(level)}
        for at, level in zip(envelope.time_s, envelope.level, strict=True)
    ]
    for one in envelope.transients:
        point = amplitude[one.place]
        strength = min(1.0, max(point["amplitude"], point["amplitude"] + one.amplitude))
        point["emphasis"] = {
            "amplitude": _rounded(strength),
            "frequency": _rounded(relative(np.array(one.hz))),
        }
    document = {
        "version": {"major": 1, "minor": 0, "patch": 0},
        "metadata": {
            "editor": "Haptic Cushion",
            "author": "",
            "source": "",
            "project": "",
            "tags": [],
            "description": (
                f"frequency 0 to 1 is {VIBRATION_LOW_HZ:g} to {VIBRATION_HIGH_HZ:g} Hz of "
                f"vibration; {band_text(job.options.device_band_hz)}"
            ),
        },
        "signals": {
            "continuous": {
                "envelopes": {
                    "amplitude": amplitude,
                    "frequency": [
                        {"time": _rounded(at), "frequency": _rounded(value)}
                        for at, value in zip(envelope.time_s, frequency, strict=True)
                    ],
                }
            }
        },
    }
    clipped = envelope.clipped_points
    warnings = (f"{clipped} points beyond full scale were limited",) if clipped else ()
    text = json.dumps(document, separators=(",", ":"))
    return text.encode(), Composed(envelope.error, warnings)


def relative(hz: FloatArray) -> FloatArray:
    """Return frequencies of vibration as 0 to 1 of 20-220 Hz.

    A player maps 0 to 1 to its actuator's band, so a device's band changes nothing here.
    """
    share = (hz - VIBRATION_LOW_HZ) / (VIBRATION_HIGH_HZ - VIBRATION_LOW_HZ)
    return np.clip(share, 0.0, 1.0)


def _rounded(value: float | FloatArray) -> float:
    return round(float(value), DECIMALS) + 0.0

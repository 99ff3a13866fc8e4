""".haptic 1.0.0 of Meta and Lofelt: amplitude and frequency envelopes, emphasis at onsets.

An envelope has at least two points, in order of time. An emphasis is a pulse that a player adds to
the envelope. The amplitude of an emphasis is at least that of the envelope at the same time.
"""

from functools import partial
from typing import Any

import numpy as np

from audioflinger_hook.exports.envelope import Limits, envelope_of
from audioflinger_hook.exports.glides import VibrationCurve
from audioflinger_hook.exports.options import (
    VIBRATION_HIGH_HZ,
    VIBRATION_LOW_HZ,
    Band,
    band_text,
    share_of,
)
from audioflinger_hook.exports.parametric import SHORTEST_S, Composed, Content, json_bytes, rounded
from device.units import FloatArray

LIMITS = Limits(spacing_s=1 / 59, longest_s=2.0)

# maps 20-220 Hz to 0-1, which a player maps to the frequency band of its actuator
_relative = partial(share_of, low_hz=VIBRATION_LOW_HZ, high_hz=VIBRATION_HIGH_HZ)


def compose(curve: VibrationCurve, duration_s: float, band_hz: Band | None) -> Content:
    """Return the content of a .haptic file, with its measured errors and warnings."""
    envelope = envelope_of(curve, max(SHORTEST_S, duration_s), LIMITS)
    amplitude = _points("amplitude", envelope.time_s, envelope.level)
    for one in envelope.transients:
        point = amplitude[one.place]
        strength = min(1.0, point["amplitude"] + one.amplitude)
        hz = float(_relative(np.array(one.hz)))
        point["emphasis"] = {"amplitude": rounded(strength), "frequency": rounded(hz)}
    frequency = _points("frequency", envelope.time_s, _relative(envelope.hz))
    document = {
        "version": {"major": 1, "minor": 0, "patch": 0},
        "metadata": {
            "editor": "Haptic Cushion",
            **dict.fromkeys(("author", "source", "project"), ""),
            "tags": [],
            "description": (
                f"frequency 0 to 1 is {VIBRATION_LOW_HZ:g} to {VIBRATION_HIGH_HZ:g} Hz of "
                f"vibration; {band_text(band_hz)}"
            ),
        },
        "signals": {"continuous": {"envelopes": {"amplitude": amplitude, "frequency": frequency}}},
    }
    return json_bytes(document), Composed(envelope.error, envelope.warnings)


def _points(name: str, time_s: FloatArray, values: FloatArray) -> list[dict[str, Any]]:
    return [
        {"time": rounded(at), name: rounded(value)}
        for at, value in zip(time_s, values, strict=True)
    ]

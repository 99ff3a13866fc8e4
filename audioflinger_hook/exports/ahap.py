"""AHAP 1.0 for Apple's Core Haptics: continuous events, parameter curves, and transients.

An event lasts at most 30 s. A curve has at most 16 points, and at most 60 in each second. Times of
points are relative to the start of their curve. A player multiplies an event's intensity by the
intensity curve, so the intensity written for a transient is divided by this curve. A player adds
the sharpness curve to an event's sharpness. Intensity is the square root of amplitude.
"""

from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from audioflinger_hook.exports.envelope import Envelope, Limits, envelope_of
from audioflinger_hook.exports.glides import VibrationCurve
from audioflinger_hook.exports.options import Band, band_text, share_of, to_device_hz
from audioflinger_hook.exports.parametric import SHORTEST_S, Composed, Content, json_bytes, rounded
from device.units import FloatArray

CONTINUOUS_MAX_S = 30.0
CURVE_POINTS_MAX = 16
SHARPNESS_LOW_HZ, SHARPNESS_HIGH_HZ = 65.0, 300.0
"""Frequencies of sharpness 0 and 1; the scale is linear. Apple publishes no scale; these are the
values in common use."""
# returns the sharpness, 0 to 1, that is written for frequencies in Hz
sharpness_of = partial(share_of, low_hz=SHARPNESS_LOW_HZ, high_hz=SHARPNESS_HIGH_HZ)

LIMITS = Limits(spacing_s=1 / 59, longest_s=2.0, square_root=True)


def compose(curve: VibrationCurve, duration_s: float, band_hz: Band | None) -> Content:
    """Return the content of an AHAP file, with its measured errors and warnings."""
    length_s = max(SHORTEST_S, duration_s)
    envelope = envelope_of(curve, length_s, LIMITS)
    hz = to_device_hz(envelope.hz, band_hz)
    sharpness = sharpness_of(hz)
    edges = [*np.arange(0.0, length_s, CONTINUOUS_MAX_S).tolist(), length_s]
    if len(edges) > 2 and edges[-1] - edges[-2] < SHORTEST_S:
        edges.pop()
    continuous = [
        {"Event": {"Time": rounded(first), "EventType": "HapticContinuous",
                   "EventDuration": rounded(min(CONTINUOUS_MAX_S, end - first)),
                   "EventParameters": _parameters(1.0, 0.0)}}
        for first, end in pairwise(edges)
    ]  # fmt: skip
    pattern = [
        *continuous,
        *_curves("HapticIntensityControl", envelope.time_s, envelope.level),
        *_curves("HapticSharpnessControl", envelope.time_s, sharpness),
        *_transients(envelope, sharpness, band_hz),
    ]
    document = {
        "Version": 1.0,
        "Metadata": {
            "Project": "Haptic Cushion",
            "Description": (
                "HapticIntensity is the square root of amplitude; sharpness 0 to 1 is "
                f"{SHARPNESS_LOW_HZ:g} to {SHARPNESS_HIGH_HZ:g} Hz, linear; {band_text(band_hz)}"
            ),
        },
        "Pattern": pattern,
    }
    return json_bytes(document), Composed(envelope.error, _warnings(envelope, hz))


def _curves(name: str, time_s: FloatArray, values: FloatArray) -> list[dict[str, Any]]:
    """Split a parameter's curve at each step of the value, and into curves of up to 16 points."""
    curves = []
    first = 0
    while first < time_s.size - 1:
        step = np.flatnonzero(np.diff(time_s[first : first + CURVE_POINTS_MAX]) <= 0.0)
        end = min([first + CURVE_POINTS_MAX, time_s.size, *(first + 1 + step[:1])])
        start_s = rounded(time_s[first])
        points = [
            {"Time": rounded(at - start_s), "ParameterValue": rounded(value)}
            for at, value in zip(time_s[first:end], values[first:end], strict=True)
        ]
        curves.append(
            {"ParameterCurve": {"ParameterID": name, "Time": start_s,
                                "ParameterCurveControlPoints": points}}
        )  # fmt: skip
        # The next curve repeats the last point, except at a step of the level.
        first = end if step.size else end - 1
    return curves


def _transients(
    envelope: Envelope, sharpness: FloatArray, band_hz: Band | None
) -> list[dict[str, Any]]:
    events = []
    for one in envelope.transients:
        intensity = min(1.0, float(np.sqrt(one.amplitude)) / max(envelope.level[one.place], 1e-6))
        wanted = sharpness_of(to_device_hz(np.array(one.hz), band_hz))
        added = float(np.clip(wanted - sharpness[one.place], 0.0, 1.0))
        events.append(
            {"Event": {"Time": rounded(one.time_s), "EventType": "HapticTransient",
                       "EventParameters": _parameters(intensity, added)}}
        )  # fmt: skip
    return events


def _parameters(intensity: float, sharpness: float) -> list[dict[str, Any]]:
    return [
        {"ParameterID": "HapticIntensity", "ParameterValue": rounded(intensity)},
        {"ParameterID": "HapticSharpness", "ParameterValue": rounded(sharpness)},
    ]


def _warnings(envelope: Envelope, hz: FloatArray) -> tuple[str, ...]:
    low = float(np.average(hz < SHARPNESS_LOW_HZ, weights=envelope.level + 1e-12))
    if low <= 0.1 or not envelope.level.any():
        return envelope.warnings
    warning = (
        f"{low:.0%} of the vibration is under {SHARPNESS_LOW_HZ:g} Hz, where AHAP's sharpness "
        "is 0; --device-band 80:230 keeps its frequencies apart"
    )
    return (warning, *envelope.warnings)

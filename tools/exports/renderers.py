"""Renders exported files to vibration, like a player of each format.

A renderer gets only the content of the file, the duration and the sample rate. A transient is a
pulse that decays linearly to 0 within 20 ms, in phase with the oscillator. All vibrations are
(frames,) float64 with full scale ±1.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from typing import Any

import numpy as np

from audioflinger_hook.exports.ahap import SHARPNESS_HIGH_HZ, SHARPNESS_LOW_HZ
from audioflinger_hook.exports.envelope import TRANSIENT_S
from audioflinger_hook.exports.options import VIBRATION_HIGH_HZ, VIBRATION_LOW_HZ
from device.units import FloatArray

MOTOR_HZ = 160.0  # resonance in Hz of a phone's motor, for waveform effects without frequencies


def render_ahap(content: bytes, duration_s: float, rate_hz: int) -> FloatArray:
    """Return the vibration of an AHAP file. Curves multiply intensity, and add to sharpness."""
    times = _times(duration_s, rate_hz)
    pattern = json.loads(content)["Pattern"]
    intensity_curve = _ahap_curve(pattern, "HapticIntensityControl", times, 1.0)
    sharpness_curve = _ahap_curve(pattern, "HapticSharpnessControl", times, 0.0)
    intensity, sharpness = np.zeros((2, times.size))
    pulses: list[tuple[float, float]] = []
    for event in (entry["Event"] for entry in pattern if "Event" in entry):
        values = {one["ParameterID"]: one["ParameterValue"] for one in event["EventParameters"]}
        first = int(np.searchsorted(times, event["Time"]))
        if event["EventType"] == "HapticContinuous":
            end = int(np.searchsorted(times, event["Time"] + event["EventDuration"]))
            intensity[first:end] = values["HapticIntensity"]
            sharpness[first:end] = values["HapticSharpness"]
        elif first < times.size:
            # This is the curve's value at the first sample of the transient.
            level = values["HapticIntensity"] * intensity_curve[first]
            pulses.append((event["Time"], level**2))
    total = np.clip(sharpness + sharpness_curve, 0.0, 1.0)
    hz = SHARPNESS_LOW_HZ + total * (SHARPNESS_HIGH_HZ - SHARPNESS_LOW_HZ)
    amplitude = np.clip(intensity * intensity_curve, 0.0, 1.0) ** 2
    return _oscillator(_with_pulses(amplitude, pulses, times), hz, rate_hz)


def _ahap_curve(pattern: list[Any], name: str, times: FloatArray, rest: float) -> FloatArray:
    """Return a parameter's values at `times`; the value before its first curve is `rest`."""
    value = np.full(times.size, rest)
    for curve in (entry["ParameterCurve"] for entry in pattern if "ParameterCurve" in entry):
        if curve["ParameterID"] != name:
            continue
        points = curve["ParameterCurveControlPoints"]
        at = curve["Time"] + np.array([point["Time"] for point in points])
        first = int(np.searchsorted(times, curve["Time"]))
        value[first:] = np.interp(times[first:], at, [point["ParameterValue"] for point in points])
    return value


def render_haptic(content: bytes, duration_s: float, rate_hz: int) -> FloatArray:
    """Return the vibration of a .haptic file. Frequencies of 0 to 1 stand for 20 to 220 Hz."""
    times = _times(duration_s, rate_hz)
    envelopes = json.loads(content)["signals"]["continuous"]["envelopes"]
    points = envelopes["amplitude"]
    amplitude = _interp(times, [(one["time"], one["amplitude"]) for one in points])
    frequency = _interp(times, [(one["time"], one["frequency"]) for one in envelopes["frequency"]])
    pulses = [
        (one["time"], one["emphasis"]["amplitude"] - one["amplitude"])
        for one in points
        if "emphasis" in one
    ]
    hz = VIBRATION_LOW_HZ + frequency * (VIBRATION_HIGH_HZ - VIBRATION_LOW_HZ)
    return _oscillator(_with_pulses(amplitude, pulses, times), hz, rate_hz)


def render_vibration_xml(content: bytes, duration_s: float, rate_hz: int) -> FloatArray:
    """Return the vibration of an Android XML file: an envelope effect, or steps of a waveform."""
    times = _times(duration_s, rate_hz)
    effect = ElementTree.fromstring(content)[0]
    if effect.tag == "waveform-envelope-effect":
        hz0 = float(effect.attrib["initialFrequencyHz"])
        points = [(0.0, 0.0, hz0)]
        for point in effect:
            at_s = points[-1][0] + 1e-3 * float(point.attrib["durationMs"])
            values = float(point.attrib["amplitude"]), float(point.attrib["frequencyHz"])
            points.append((at_s, *values))
        at, level, hz = np.array(points).T
        return _oscillator(np.interp(times, at, level), np.interp(times, at, hz), rate_hz)
    durations = np.array([float(step.attrib["durationMs"]) for step in effect])
    levels = np.array([float(step.attrib["amplitude"]) for step in effect]) / 255.0
    ends_s = 1e-3 * np.cumsum(durations)
    place = np.minimum(np.searchsorted(ends_s, times, "right"), levels.size - 1)
    amplitude = np.where(times < ends_s[-1], levels[place], 0.0)
    return _oscillator(amplitude, np.full(times.size, MOTOR_HZ), rate_hz)


def render_hjif(content: bytes, duration_s: float, rate_hz: int) -> FloatArray:
    """Return the vibration of an HJIF file: the sum of the waves of all bands and channels."""
    document = json.loads(content)
    vibration = np.zeros(_times(duration_s, rate_hz).size)
    for perception in document["perceptions"]:
        for channel in perception["channels"]:
            for band in channel["bands"]:
                for effect in band["effects"]:
                    _add_wave(vibration, effect, document["timescale"], rate_hz)
    return vibration


def _add_wave(vibration: FloatArray, effect: Any, timescale: int, rate_hz: int) -> None:
    keys = effect["keyframes"]
    at = np.array([key["relative_position"] for key in keys]) / timescale
    start_s = effect["position"] / timescale
    first = int(np.ceil(start_s * rate_hz))
    end = min(vibration.size, int(np.ceil((start_s + at[-1]) * rate_hz)))
    since = np.arange(first, end) / rate_hz - start_s
    hz = np.interp(since, at, [key["frequency_modulation"] for key in keys])
    level = np.interp(since, at, [key["amplitude_modulation"] for key in keys])
    vibration[first:end] += level * np.sin(2.0 * np.pi * hz * since + effect["phase"])


def render_partials(content: bytes, duration_s: float, rate_hz: int) -> FloatArray:
    """Return the vibration of a file of partial tracks: the sum of all tracks."""
    vibration = np.zeros(_times(duration_s, rate_hz).size)
    for line in content.splitlines():
        track = json.loads(line)
        if track["type"] != "track":
            continue
        at, hz, amplitude, phase = np.array(track["points"]).T
        first = max(0, int(np.ceil(at[0] * rate_hz)))
        end = min(vibration.size, int(np.ceil(at[-1] * rate_hz)))
        if end <= first:
            continue
        times = np.arange(first, end) / rate_hz
        place = np.clip(np.searchsorted(at, times, "right") - 1, 0, at.size - 2)
        length, since = np.diff(at), times - at[place]
        slope = np.diff(hz) / length
        turned = length * (hz[:-1] + hz[1:]) / 2
        # The phases at the points correct the error of linear interpolation of frequency.
        missed = (np.diff(phase) - turned + 0.5) % 1.0 - 0.5
        turns = phase[place] + since * (
            hz[place] + 0.5 * slope[place] * since + missed[place] / length[place]
        )
        level = np.interp(times, at, amplitude)
        vibration[first:end] += level * np.cos(2.0 * np.pi * turns)
    return vibration


RENDERERS: dict[str, Callable[[bytes, float, int], FloatArray]] = {
    "ahap": render_ahap,
    "haptic": render_haptic,
    "vibration-xml": render_vibration_xml,
    "hjif": render_hjif,
    "partials": render_partials,
}
"""Renderers by format. Arguments: content of a file, duration in s, rate in Hz."""


def _times(duration_s: float, rate_hz: int) -> FloatArray:
    return np.arange(max(1, round(duration_s * rate_hz))) / rate_hz


def _interp(times: FloatArray, points: list[tuple[float, float]]) -> FloatArray:
    at, values = np.array(points).T
    found: FloatArray = np.interp(times, at, values)
    return found


def _with_pulses(
    amplitude: FloatArray, pulses: list[tuple[float, float]], times: FloatArray
) -> FloatArray:
    total = amplitude.copy()
    for start_s, level in pulses:
        first, end = np.searchsorted(times, [start_s, start_s + TRANSIENT_S])
        total[first:end] += level * (1.0 - (times[first:end] - start_s) / TRANSIENT_S)
    return total


def _oscillator(amplitude: FloatArray, hz: FloatArray, rate_hz: int) -> FloatArray:
    vibration: FloatArray = amplitude * np.cos(2.0 * np.pi * np.cumsum(hz) / rate_hz)
    return vibration

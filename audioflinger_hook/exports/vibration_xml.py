"""Vibration XML of Android 16: an envelope of up to 16 points, or a waveform of steps.

Each point of an envelope effect has an amplitude and a frequency. All devices accept up to 16
points, 20 ms to 1 s apart, with amplitude 0 at the end. If 16 points are too inaccurate, a waveform
effect is written. This is a sequence of amplitudes, 0 to 255, that last 10 ms or more each. The
device then vibrates at the frequency of its motor.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from audioflinger_hook.exports.envelope import Envelope, Limits, envelope_error, envelope_of
from audioflinger_hook.exports.glides import VibrationCurve
from audioflinger_hook.exports.options import Band, band_text, to_device_hz
from audioflinger_hook.exports.parametric import Composed, Content
from device.errors import UsageError

POINTS_MAX, POINT_MIN_MS, POINT_MAX_MS = 16, 20, 1_000
AMPLITUDE_MAX = 255
STEP_MS = 10  # shortest step of a waveform
STEPS_MAX = 20_000  # largest number of steps of a waveform
SILENT_MS = 200  # pauses shorter than this get amplitude 1 of 255, so that the motor does not stop
TOLERANCES = (0.012, 0.025, 0.05)
FOLLOWS_DB = -20.0  # an envelope effect with a larger `envelope_error_db` becomes a waveform

LIMITS = Limits(spacing_s=1e-3 * POINT_MIN_MS, longest_s=0.9, transients=False)
STEP_TOLERANCE = 0.02


def compose(curve: VibrationCurve, duration_s: float, band_hz: Band | None) -> Content:
    """Return the content of a vibration file, with its measured errors and warnings."""
    length_s = max(1e-3 * POINT_MIN_MS, duration_s)
    for tolerance in TOLERANCES:
        envelope = envelope_of(curve, length_s, replace(LIMITS, tolerance=tolerance))
        if len(points := _points(envelope)) > POINTS_MAX:
            continue
        ends_s = 1e-3 * np.cumsum([0, *(duration for duration, _, _ in points)])
        levels = np.array([0.0, *(level for _, level, _ in points)])
        error = envelope_error(curve, np.interp(curve.times_s, ends_s, levels))
        if error.get("envelope_error_db", -120.0) <= FOLLOWS_DB:
            hz = to_device_hz(np.array([envelope.hz[0], *(one[2] for one in points)]), band_hz)
            lines = [
                f'    <control-point amplitude="{level:.4f}" frequencyHz="{at_hz:.2f}" '
                f'durationMs="{duration}"/>'
                for (duration, level, _), at_hz in zip(points, hz[1:].tolist(), strict=True)
            ]
            head = f'  <waveform-envelope-effect initialFrequencyHz="{hz[0]:.2f}">'
            body = [head, *lines, "  </waveform-envelope-effect>"]
            composed = Composed({**error, "points": float(len(points))})
            return _document(body, band_text(band_hz)), composed
    return _waveform_effect(curve, length_s, band_hz)


def _points(envelope: Envelope) -> list[tuple[int, float, float]]:
    """Return points: ms since the previous point, amplitude, Hz. The last amplitude is 0."""
    reach = POINT_MIN_MS // 2
    last_ms = max(POINT_MIN_MS, round(1e3 * float(envelope.time_s[-1])))
    points: list[tuple[int, float, float]] = []
    now_ms = 0
    rows = list(zip(envelope.time_s.tolist(), envelope.level, envelope.hz, strict=True))
    for place, (time_s, level, hz) in enumerate(rows):
        at_ms = round(1e3 * time_s)
        # A jump of the envelope becomes a ramp centred on the jump.
        if place + 1 < len(rows) and rows[place + 1][0] == time_s:
            at_ms -= reach
        elif place and rows[place - 1][0] == time_s:
            at_ms += reach
        if place == 0 and level < 0.01:
            continue
        at_ms = max(at_ms, now_ms + POINT_MIN_MS)
        if at_ms > last_ms and points:
            break
        points.append((at_ms - now_ms, float(level), float(hz)))
        now_ms = at_ms
    if not points or points[-1][1] > 0.0:
        points.append((POINT_MIN_MS, 0.0, rows[-1][2]))
    parts: list[tuple[int, float, float]] = []
    before = 0.0
    for duration, level, hz in points:
        pieces = -(-duration // POINT_MAX_MS)
        for piece in range(pieces):
            length = duration * (piece + 1) // pieces - duration * piece // pieces
            parts.append((length, before + (level - before) * (piece + 1) / pieces, hz))
        before = level
    return parts


def _waveform_effect(curve: VibrationCurve, duration_s: float, band_hz: Band | None) -> Content:
    if len(steps := _steps(curve, duration_s)) > STEPS_MAX:
        raise UsageError(
            f"the sound of {duration_s:.0f} s needs {len(steps)} steps in the format "
            f"vibration-xml; allowed: {STEPS_MAX}, about {STEPS_MAX * STEP_MS / 1e3:g} s of "
            "changing vibration; cut the sound, or choose one of: ogg-haptic, partials, hjif"
        )
    lines = [
        f'    <waveform-entry durationMs="{duration}" amplitude="{amplitude}"/>'
        for duration, amplitude in steps
    ]
    ends_s = 1e-3 * np.cumsum([0, *(duration for duration, _ in steps)])
    levels = np.array([amplitude for _, amplitude in steps]) / AMPLITUDE_MAX
    times, values = np.repeat(ends_s, 2)[1:-1], np.repeat(levels, 2)
    error = envelope_error(curve, np.interp(curve.times_s, times, values))
    warning = (
        "the vibration needs more than 16 points, so the file holds amplitudes without "
        "frequencies; the phone's motor vibrates at its own"
    )
    body = ["  <waveform-effect>", *lines, "  </waveform-effect>"]
    composed = Composed({**error, "steps": float(len(steps))}, (warning,))
    return _document(body, "amplitude 255 is full scale"), composed


def _steps(curve: VibrationCurve, duration_s: float) -> list[tuple[int, int]]:
    """Return steps: (duration in ms, amplitude 0 to 255). A step begins at every onset."""
    last_ms = round(1e3 * duration_s)
    onsets = sorted({round(1e3 * one.time_s) for one in curve.onsets} & set(range(1, last_ms)))
    edges: list[int] = []
    for first, end in zip([0, *onsets], [*onsets, last_ms], strict=True):
        cells = max(1, (end - first) // STEP_MS)
        edges += [first + (end - first) * cell // cells for cell in range(cells)]
    edges.append(last_ms)
    power = np.concatenate(([0.0], np.cumsum(curve.amplitude.astype(np.float64) ** 2)))
    # Compute the mean power of each step. The running sum is interpolated between samples.
    place = np.clip((1e-3 * np.array(edges) - curve.start_s) * curve.rate_hz + 0.5, 0, None)
    total = np.interp(place, np.arange(power.size), power)
    levels = np.sqrt(np.diff(total) / np.maximum(np.diff(place), 1e-9))
    amplitude = np.clip(np.rint(AMPLITUDE_MAX * levels), 0, AMPLITUDE_MAX).astype(int)
    durations = np.diff(edges)
    rests = amplitude == 0
    for begin, end in pairwise((np.flatnonzero(np.diff(rests)) + 1).tolist()):
        if rests[begin] and int(durations[begin:end].sum()) < SILENT_MS:
            amplitude[begin:end] = 1
    return _merged(amplitude, durations, {0, *onsets}, edges)


def _merged(
    amplitude: Any, durations: Any, begins: set[int], edges: list[int]
) -> list[tuple[int, int]]:
    """Join steps of nearly equal amplitude, except at onsets and at both ends of a pause."""
    allowed = max(1.0, STEP_TOLERANCE * float(amplitude.max(initial=0)))
    steps: list[tuple[int, int]] = []
    low = high = 0
    for place, level in enumerate(amplitude.tolist()):
        duration = int(durations[place])
        new_low, new_high = min(low, level), max(high, level)
        fresh = not steps or edges[place] in begins or (level == 0) != (steps[-1][1] == 0)
        if fresh or new_high - new_low > allowed:
            steps.append((duration, level))
            low = high = level
        else:
            low, high = new_low, new_high
            steps[-1] = (steps[-1][0] + duration, (low + high + 1) // 2)
    return steps


def _document(body: list[str], comment: str) -> bytes:
    lines = [f"<!-- Haptic Cushion: {comment} -->", "<vibration-effect>", *body]
    return "\n".join([*lines, "</vibration-effect>", ""]).encode()

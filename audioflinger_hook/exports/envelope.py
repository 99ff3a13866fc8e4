"""An envelope of few points, and transients, for formats that play one oscillator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.exports.glides import Onset, VibrationCurve
from audioflinger_hook.exports.simplify import fitted, simplify
from device.units import FloatArray, amplitude_to_db

SMOOTHED_S = 0.03
"""Length of the Hann window over power: swings above about 20 Hz are not kept, since a few dozen
points a second cannot show them. The window never reaches beyond an onset."""

TRANSIENT_S = 0.02
"""Length of a transient, which falls to 0 in a straight line. It has half of an onset's rise; the
envelope starts with the other half and has all of it after this time."""

FREQUENCY_TOLERANCE_HZ = 4.0  # where the envelope is largest; more where it is weak


@dataclass(frozen=True)
class Limits:
    """What the points of a format must keep.

    spacing_s: least distance of two points; at an onset two points share a time.
    longest_s: largest distance of two points.
    square_root: the player squares levels, so the square root of amplitude is written.
    tolerance: largest error of the envelope, of its largest written value.
    transients: whether an onset's rise is shared between the envelope and a transient.
    """

    spacing_s: float
    longest_s: float
    square_root: bool = False
    tolerance: float = 0.012
    transients: bool = True


@dataclass(frozen=True)
class Transient:
    """A short pulse on top of the envelope. place: of the envelope's point where it begins."""

    place: int
    time_s: float
    amplitude: float
    hz: float


@dataclass(frozen=True)
class Envelope:
    """Points of written level (0 to 1) and frequency in Hz; linear between them.

    time_s, level, hz: (n,) from 0 to the duration; two points at an onset have the same time.
    transients: in order of time.
    error: `envelope_error_db`, r.m.s. error of the smoothed envelope with its transients, in dB of
        its r.m.s.; `frequency_error_hz`, r.m.s., weighted by power; counts `points`, `transients`.
    """

    time_s: FloatArray
    level: FloatArray
    hz: FloatArray
    transients: tuple[Transient, ...]
    error: dict[str, float]
    warnings: tuple[str, ...]


def envelope_of(curve: VibrationCurve, duration_s: float, limits: Limits) -> Envelope:
    """Return the simplified envelope of a channel's vibration.

    duration_s: where the last point is.
    """
    rate = curve.rate_hz
    times = curve.times_s
    at = _onsets_at(curve)
    edges, smooth = _edges(curve), smoothed(curve)
    lowered, found = smooth.copy(), dict[int, Transient]()
    length = max(1, round(TRANSIENT_S * rate))
    for cut in edges[1:-1] if limits.transients else ():
        after = smooth[cut : cut + length]
        fall = 1.0 - np.arange(after.size) / length
        # Half of the rise, and never more than half of the level: what is left for the envelope is
        # then at least as much as the transient, whose intensity its curve multiplies.
        pulse = 0.5 * min(float(after.max() - smooth[cut - 1]), float((after / fall).min()))
        if pulse > 0.0:
            lowered[cut : cut + after.size] -= pulse * fall
            found[cut] = Transient(0, at[cut].time_s, pulse, at[cut].hz)
    written = np.sqrt(lowered) if limits.square_root else lowered
    clipped, written = written > 1.0, np.minimum(written, 1.0)
    points = np.column_stack((written, curve.hz.astype(np.float64)))
    loudest = max(1e-9, float(points[:, 0].max()))
    share = np.maximum(1e-3, lowered / max(1e-12, float(lowered.max())))
    tolerance = np.column_stack(
        (np.full(times.size, limits.tolerance * loudest), FREQUENCY_TOLERANCE_HZ / np.sqrt(share))
    )
    longest = max(1, int(limits.longest_s * rate))
    time_s: list[float] = []
    levels: list[FloatArray] = []
    kept: list[NDArray[np.intp]] = []
    transients: list[Transient] = []
    for first, end in pairwise(edges):
        # An onset lies between two samples: the segments on both sides end there.
        begins = at[first].time_s if first else 0.0
        ends = at[end].time_s if end < times.size else duration_s
        part = slice(first, end)
        # With its two ends a segment has no more points than its share of a second allows.
        allowed = max(2, int((ends - begins) / limits.spacing_s + 0.01) + 1)
        spacing = max(1, int(np.ceil((end - first) / (allowed - 1))))
        chosen = first + simplify(times[part], points[part], tolerance[part], spacing, longest)
        if len(chosen) == 1:
            chosen = np.repeat(chosen, 2)
        if first in found:
            one = found[first]
            transients.append(Transient(len(time_s), begins, one.amplitude, one.hz))
        time_s += [begins, *np.clip(times[chosen[1:-1]], begins, ends).tolist(), ends]
        levels.append(np.clip(fitted(times[part], written[part], times[chosen]), 0.0, 1.0))
        kept.append(chosen)
    places = np.concatenate(kept)
    level, hz, at_s = np.concatenate(levels), points[places, 1], np.array(time_s)
    played = np.square(level) if limits.square_root else level
    error = _errors(curve, smooth, at_s, played, hz, transients)
    limited = int(clipped[places].sum())
    warnings = (f"{limited} points beyond full scale were limited",) if limited else ()
    return Envelope(at_s, level, hz, tuple(transients), error, warnings)


def envelope_error(curve: VibrationCurve, amplitude: FloatArray) -> dict[str, float]:
    """Return `envelope_error_db` of amplitudes at the curve's times; nothing for silence."""
    wanted = smoothed(curve)
    total = float(np.square(wanted).sum())
    if not total:
        return {}
    off = smoothed(replace(curve, amplitude=amplitude.astype(np.float32))) - wanted
    error = float(np.sqrt(np.square(off).sum() / total))
    return {"envelope_error_db": max(-120.0, amplitude_to_db(error))}


def smoothed(curve: VibrationCurve) -> FloatArray:
    """Return the amplitude smoothed between onsets."""
    parts = [curve.amplitude[first:end] for first, end in pairwise(_edges(curve))]
    return np.concatenate([_smoothed(part.astype(np.float64), curve.rate_hz) for part in parts])


def _edges(curve: VibrationCurve) -> list[int]:
    """Return the first place, those after each onset, and the number of places."""
    size = curve.amplitude.size
    return [0, *sorted(place for place in _onsets_at(curve) if 0 < place < size), size]


def _onsets_at(curve: VibrationCurve) -> dict[int, Onset]:
    """Return the onsets by the place after each."""
    start_s, rate_hz = curve.start_s, curve.rate_hz
    return {int(np.ceil((one.time_s - start_s) * rate_hz)): one for one in curve.onsets}


def _errors(
    curve: VibrationCurve,
    smooth: FloatArray,
    time_s: FloatArray,
    amplitude: FloatArray,
    hz: FloatArray,
    transients: list[Transient],
) -> dict[str, float]:
    """Return the errors of an envelope, given by its points, as a player plays it."""
    times, power = curve.times_s, smooth * smooth
    played = np.interp(times, time_s, amplitude)
    for one in transients:
        first, end = np.searchsorted(times, [one.time_s, one.time_s + TRANSIENT_S])
        age = (times[first:end] - one.time_s) / TRANSIENT_S
        played[first:end] += one.amplitude * (1.0 - age)
    found = {"points": float(time_s.size), "transients": float(len(transients))}
    found |= envelope_error(curve, played)
    if power.any():
        off_hz = np.interp(times, time_s, hz) - curve.hz
        found["frequency_error_hz"] = float(np.sqrt((power * off_hz**2).sum() / power.sum()))
    return found


def _smoothed(amplitude: FloatArray, rate_hz: float) -> FloatArray:
    """Return the r.m.s. under a Hann window, which gives way to a third of it at both ends.

    A whole window, cut off at an onset, would look ahead of its rise.
    """
    half = max(1, round(0.5 * SMOOTHED_S * rate_hz))
    square = amplitude**2
    place = np.arange(square.size)
    share = np.minimum(1.0, np.minimum(place, place[::-1]) / half)
    whole, short = _mean(square, half), _mean(square, max(1, half // 3))
    return np.sqrt(share * whole + (1.0 - share) * short)


def _mean(square: FloatArray, half: int) -> FloatArray:
    window = np.hanning(2 * half + 3)[1:-1]
    part = slice(half, half + square.size)
    weight = np.convolve(np.ones(square.size), window)[part]
    return np.convolve(square, window)[part] / weight

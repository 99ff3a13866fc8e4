"""Approximates curves with straight lines, and a vibration with an envelope and transients."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from audioflinger_hook.exports.glides import Onset, VibrationCurve
from device.units import FloatArray, amplitude_to_db

TIED = 1e-3  # weight in `fitted` of the curve's value at a knot; a sample has weight 1


def simplify(
    times: FloatArray,
    values: FloatArray,
    tolerance: FloatArray,
    spacing: int,
    longest: int,
    sizes: Sequence[int] | None = None,
) -> NDArray[np.intp]:
    """Return ascending indices of the points to keep, including the first and the last point.

    Points are added until all errors are at most `tolerance`, or `spacing` permits no more points.
    An error is the distance of a curve from the straight line between kept points.

    times: (n,) ascending.
    values: (n, k) values of k curves. The same points are kept in all curves.
    tolerance: (n, k) largest allowed error at each point.
    spacing: smallest allowed difference of consecutive kept indices, except the last difference.
    longest: largest allowed difference of consecutive kept indices.
    sizes: numbers of points of successive curves, each with its own first and last point; None: the
        points are of one curve.
    """
    begins = np.cumsum([0, *(sizes or [len(values)])])
    curves = list(zip(values.T.copy(), tolerance.T.copy(), strict=True))
    kept = np.zeros(len(values), dtype=np.bool_)
    lines: list[tuple[int, int]] = []
    for begin, end in pairwise(begins.tolist()):
        last = end - 1
        edges = [*range(begin, last, longest), last]
        if len(edges) > 2 and edges[-1] - edges[-2] < spacing:
            edges.pop(-2)
            if last - edges[-2] > longest:  # two points may be at most `longest` apart
                edges.insert(-1, last - spacing)
        kept[edges] = True
        lines += pairwise(edges)
    first, end = np.array(lines, np.intp).reshape(-1, 2).T
    while True:
        wide = end - first >= 2 * spacing
        first, end = first[wide], end[wide]
        if not first.size:
            return np.flatnonzero(kept)
        # The points where each line may be split, of all lines in a row.
        count = end - first - 2 * spacing + 1
        begin = np.cumsum(count) - count
        place = np.arange(count.sum()) + np.repeat(first + spacing - begin, count)
        since = times[place] - np.repeat(times[first], count)
        error = np.zeros(place.size)
        for value, allowed in curves:
            slope = (value[end] - value[first]) / (times[end] - times[first])
            drawn = np.repeat(value[first], count) + np.repeat(slope, count) * since
            np.maximum(error, np.abs(value[place] - drawn) / allowed[place], out=error)
        largest = np.maximum.reduceat(error, begin)
        split = largest > 1.0
        worst = np.flatnonzero(error == np.repeat(np.where(split, largest, np.nan), count))
        middle = place[worst[np.searchsorted(worst, begin[split])]]
        kept[middle] = True
        first, end = np.append(first[split], middle), np.append(middle, end[split])


def fitted(times: FloatArray, values: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the values at `knots` of the piecewise linear least-squares fit to (times, values)."""
    if knots.size < 3 or knots[0] == knots[-1]:
        return np.interp(knots, times, values)
    place = np.clip(np.searchsorted(knots, times, "right") - 1, 0, knots.size - 2)
    share = (times - knots[place]) / np.diff(knots)[place]
    size = knots.size
    diagonal = np.bincount(place, (1 - share) ** 2, size) + np.bincount(place + 1, share**2, size)
    beside = np.bincount(place, share * (1 - share), size)
    wanted = np.bincount(place, (1 - share) * values, size)
    wanted += np.bincount(place + 1, share * values, size)
    # The curve's values at the knots have a small weight, so that knots without samples get values.
    bands = np.vstack((np.concatenate(([0.0], beside[:-1])), diagonal + TIED))
    aim = wanted + TIED * np.interp(knots, times, values)
    return np.asarray(scipy.linalg.solveh_banded(bands, aim))


SMOOTHED_S = 0.03
"""Length of the Hann window that smooths power. The window removes fast fluctuations, which a few
dozen points a second cannot represent. The window never extends across an onset."""

TRANSIENT_S = 0.02
"""Duration of a transient, which decays linearly to 0. The transient takes at most half of a rise
at an onset. The envelope contains the rest, and reaches the full level at the end of the transient.
"""

FREQUENCY_TOLERANCE_HZ = 4.0  # allowed error at the envelope's maximum; lower levels allow more


@dataclass(frozen=True)
class Limits:
    """What a format allows for the points of an envelope.

    spacing_s: smallest time between two points. At an onset, two points have the same time.
    longest_s: largest time between two points.
    square_root: whether to write square roots of amplitudes, for players that square the values.
    tolerance: largest allowed error of a written value, relative to the largest written value.
    transients: whether a transient plays a part of the rise at an onset.
    """

    spacing_s: float
    longest_s: float
    square_root: bool = False
    tolerance: float = 0.012
    transients: bool = True


@dataclass(frozen=True)
class Transient:
    """A pulse added to the envelope. place: index of the envelope's point at the pulse's start."""

    place: int
    time_s: float
    amplitude: float
    hz: float


@dataclass(frozen=True)
class Envelope:
    """Level, 0 to 1, and frequency in Hz of a vibration, both linear between points.

    time_s, level, hz: (n,) from 0 to the duration; at an onset, two points have the same time.
    transients: in order of time.
    error: `envelope_error_db`, r.m.s. error in dB relative to the r.m.s. of the smoothed amplitude;
        `frequency_error_hz`, r.m.s. weighted by power; numbers of `points` and `transients`.
    """

    time_s: FloatArray
    level: FloatArray
    hz: FloatArray
    transients: tuple[Transient, ...]
    error: dict[str, float]
    warnings: tuple[str, ...]


def envelope_of(curve: VibrationCurve, duration_s: float, limits: Limits) -> Envelope:
    """Return an envelope of few points for a channel's curve, with the last at `duration_s`."""
    rate = curve.rate_hz
    times = curve.times_s
    at = _onsets_at(curve)
    edges, smooth = _edges(curve), smoothed(curve)
    lowered, found = smooth.copy(), dict[int, Transient]()
    length = max(1, round(TRANSIENT_S * rate))
    for cut in edges[1:-1] if limits.transients else ():
        after = smooth[cut : cut + length]
        fall = 1.0 - np.arange(after.size) / length
        # A transient takes half of the rise, but at most half of the level. The envelope then stays
        # at least as large as the transient, whose intensity the player multiplies by the envelope.
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
        # An onset lies between two samples. There one segment ends, and the next begins.
        begins = at[first].time_s if first else 0.0
        ends = at[end].time_s if end < times.size else duration_s
        part = slice(first, end)
        # At the smallest spacing, a segment may have this many points, including its two ends.
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
    """Return the r.m.s. error of `amplitude`, dB relative to the curve's r.m.s.; {} in silence."""
    wanted = smoothed(curve)
    total = float(np.square(wanted).sum())
    if not total:
        return {}
    off = smoothed(replace(curve, amplitude=amplitude.astype(np.float32))) - wanted
    error = float(np.sqrt(np.square(off).sum() / total))
    return {"envelope_error_db": max(-120.0, amplitude_to_db(error))}


def smoothed(curve: VibrationCurve) -> FloatArray:
    """Return the amplitude's moving r.m.s. with a Hann window, shorter near onsets and ends."""
    half = max(1, round(0.5 * SMOOTHED_S * curve.rate_hz))
    parts = []
    for first, end in pairwise(_edges(curve)):
        square = curve.amplitude[first:end].astype(np.float64) ** 2
        place = np.arange(square.size)
        share = np.minimum(1.0, np.minimum(place, place[::-1]) / half)
        whole, short = _mean(square, half), _mean(square, max(1, half // 3))
        parts.append(np.sqrt(share * whole + (1.0 - share) * short))
    return np.concatenate(parts)


def _edges(curve: VibrationCurve) -> list[int]:
    """Return 0, the index of the first sample after each onset, and the number of samples."""
    size = curve.amplitude.size
    return [0, *sorted(place for place in _onsets_at(curve) if 0 < place < size), size]


def _onsets_at(curve: VibrationCurve) -> dict[int, Onset]:
    """Return the onsets, keyed by the index of the first sample at or after each onset."""
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


def _mean(square: FloatArray, half: int) -> FloatArray:
    window = np.hanning(2 * half + 3)[1:-1]
    part = slice(half, half + square.size)
    return np.convolve(square, window)[part] / np.convolve(np.ones(square.size), window)[part]

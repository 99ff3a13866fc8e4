"""Measures of the difference between a rendered export and the original vibration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import hilbert

from device.units import FloatArray

ENVELOPE_S = 0.05  # length of the Hann window that smooths the power
ONSET_WINDOW_S = 0.012
ONSET_SHARE = 0.15  # an onset is a rise of the short envelope by at least this share of its maximum
ONSET_FROM = 0.3
"""Onsets start below this share of the later level, which excludes swells and beats."""

ONSETS_APART_S = 0.08
BORN_BEFORE_S = 0.012  # largest time in s from the birth of partials to the steepest rise
ONSET_REACH_S = 0.015  # largest shift between both vibrations, in either direction, in s
AROUND_S = 0.02  # length of the comparison before and after an onset, in s


@dataclass(frozen=True)
class Likeness:
    """Correlation of the envelopes of two vibrations, and time errors of clear onsets in ms."""

    envelope: float
    onset_errors_ms: tuple[float, ...]


def likeness(
    original: FloatArray, made: FloatArray, rate_hz: int, births_s: Sequence[float] = ()
) -> Likeness:
    """Return the comparison of two vibrations, (frames,). births_s: as for `onset_errors_ms`."""
    ours, theirs = (envelope(one, rate_hz, ENVELOPE_S) for one in (original, made))
    if np.ptp(ours) and np.ptp(theirs):
        correlation = float(np.corrcoef(ours, theirs)[0, 1])
    else:
        correlation = float(np.ptp(ours) == np.ptp(theirs))
    return Likeness(correlation, onset_errors_ms(original, made, rate_hz, births_s))


def envelope(vibration: FloatArray, rate_hz: int, window_s: float) -> FloatArray:
    """Return the r.m.s. of the analytic signal under a Hann window of `window_s` seconds."""
    length = 2 * round(0.5 * window_s * rate_hz) + 1
    window = np.hanning(length + 2)[1:-1]
    power = np.abs(hilbert(vibration)) ** 2
    smooth = np.convolve(power, window / window.sum())[length // 2 :][: power.size]
    found: FloatArray = np.sqrt(np.maximum(smooth, 0.0))
    return found


def births_in(partials: bytes) -> list[float]:
    """Return the start times in s of partials that start at an onset, from a file of partials."""
    lines = (json.loads(line) for line in partials.splitlines())
    return sorted(line["points"][0][0] for line in lines if line.get("onset"))


def onset_errors_ms(
    original: FloatArray, made: FloatArray, rate_hz: int, births_s: Sequence[float]
) -> tuple[float, ...]:
    """Return the delay in ms of each clear onset of `made` relative to `original`.

    The delay is the shift that maximises the correlation of two curves: the changes of both
    envelopes over 12 ms.

    births_s: times in s of the onsets that the live form found.
    """
    ours, theirs = (_rises(one, rate_hz) for one in (original, made))
    short = envelope(original, rate_hz, ONSET_WINDOW_S)
    half, reach = round(0.5 * ONSET_WINDOW_S * rate_hz), round(ONSET_REACH_S * rate_hz)
    around = round(AROUND_S * rate_hz)
    errors: list[float] = []
    last = -round(ONSETS_APART_S * rate_hz)
    for birth_s in births_s:
        born = max(0, round(birth_s * rate_hz))
        near = ours[born : born + round(BORN_BEFORE_S * rate_hz) + 1]
        if not near.size:
            continue
        place = born + int(near.argmax())
        after = short[place : place + 2 * half + 1].max()
        clear = short[max(0, place - half)] <= ONSET_FROM * after
        strong = ours[place] >= ONSET_SHARE * short.max()
        if not (clear and strong and place - last >= round(ONSETS_APART_S * rate_hz)):
            continue
        last = place
        errors.append(1e3 * _lag(ours, theirs, place, reach, around) / rate_hz)
    return tuple(errors)


def _lag(ours: FloatArray, theirs: FloatArray, place: int, reach: int, around: int) -> int:
    """Return the shift in frames that maximises the correlation of two curves around an index."""
    pad = reach + around
    mine = np.pad(ours, pad)[place + reach : place + reach + 2 * around + 1]
    other = np.pad(theirs, pad)[place : place + 2 * (reach + around) + 1]
    windows = np.lib.stride_tricks.sliding_window_view(other, mine.size)
    centred = windows - windows.mean(axis=1, keepdims=True)
    norm = np.sqrt(np.square(centred).sum(axis=1))
    likes = centred @ (mine - mine.mean()) / np.maximum(norm, 1e-12)
    return int(likes.argmax()) - reach


def _rises(vibration: FloatArray, rate_hz: int) -> FloatArray:
    short = envelope(vibration, rate_hz, ONSET_WINDOW_S)
    half = round(0.5 * ONSET_WINDOW_S * rate_hz)
    padded = np.pad(short, (half, half), constant_values=(0.0, short[-1]))
    rises: FloatArray = padded[2 * half :] - padded[: -2 * half]
    return rises

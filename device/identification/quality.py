"""How far a sweep's response is a linear one: where coherence is low, and distortion by order."""

from dataclasses import dataclass

import numpy as np

from device.identification.recording import Recording
from device.identification.transfer import distortion, transfer
from device.units import FloatArray

LOW_COHERENCE = 0.9
"""Below, a tenth of the response's power is noise, distortion or something else."""

ABOVE_FLOOR = 3.0
"""Distortion below so many times what silence in its place shows is noise."""

_JOINED_HZ = 2.0
_SMOOTH_HZ = 5.0
"""Shares are r.m.s. values over so much: the largest of many bins of noise would look like one."""


@dataclass(frozen=True)
class Harmonic:
    """The most that one order adds. order: 2 or more; largest_share: of the linear response, by
    amplitude, at a drive of at_hz; 0 where nothing stands above the noise.
    """

    order: int
    largest_share: float
    at_hz: float


@dataclass(frozen=True)
class Quality:
    """Of one recording. names: its reference and response; coherence: the median; low_hz: the
    ranges, Hz, in which it is below LOW_COHERENCE; harmonics: by order,
    those that band and length of the sweep have room for.
    """

    names: tuple[str, str]
    coherence: float
    low_hz: tuple[tuple[float, float], ...]
    harmonics: tuple[Harmonic, ...]


def quality(recording: Recording, orders: int = 5) -> Quality:
    """What can be said of a recording besides its fit."""
    found = transfer(recording)
    f = found.frequencies_hz
    ranges: list[tuple[float, float]] = []
    for hz in f[found.coherence < LOW_COHERENCE]:
        if ranges and hz - ranges[-1][1] <= _JOINED_HZ:
            ranges[-1] = ranges[-1][0], float(hz)
        else:
            ranges.append((float(hz), float(hz)))
    harmonics = []
    sweep = recording.sweep
    for one in distortion(recording, orders):
        apart_s = sweep.harmonic_lead_s(one.order + 1) - sweep.harmonic_lead_s(one.order)
        if 0.5 * apart_s < 1.0 / sweep.low_hz:
            break  # the sweep is too quick to tell such orders apart
        step_hz = float(f[1] - f[0])
        share, floor = (_smooth(values, _SMOOTH_HZ / step_hz) for values in (one.share, one.floor))
        clear = np.where(share > ABOVE_FLOOR * floor, share, 0.0)
        at = int(np.argmax(clear))
        hz = float(one.frequencies_hz[at]) if clear[at] > 0.0 else 0.0
        harmonics.append(Harmonic(one.order, float(clear[at]), hz))
    return Quality(
        recording.names, float(np.median(found.coherence)), tuple(ranges), tuple(harmonics)
    )


def _smooth(values: FloatArray, bins: float) -> FloatArray:
    """R.m.s. over so many bins around each."""
    box = np.ones(max(1, min(round(bins), len(values))))
    mean = np.convolve(values**2, box, "same") / np.convolve(np.ones_like(values), box, "same")
    return np.asarray(np.sqrt(mean))

"""How far a sweep's response is a linear one: where coherence is low, and distortion by order."""

from dataclasses import dataclass

import numpy as np

from device.identification.recording import Recording
from device.identification.transfer import distortion, transfer

LOW_COHERENCE = 0.9
"""Below, a tenth of the response's power is noise, distortion or something else."""

ABOVE_FLOOR = 3.0
"""Distortion below so many times what silence in its place shows is noise."""

_JOINED_HZ = 2.0


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
    ranges, Hz, in which it is below LOW_COHERENCE; harmonics: by order.
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
    for one in distortion(recording, orders):
        clear = one.share > ABOVE_FLOOR * one.floor
        if np.any(clear):
            at = int(np.argmax(np.where(clear, one.share, 0.0)))
            share, hz = float(one.share[at]), float(one.frequencies_hz[at])
            harmonics.append(Harmonic(one.order, share, hz))
        else:
            harmonics.append(Harmonic(one.order, 0.0, 0.0))
    return Quality(
        recording.names, float(np.median(found.coherence)), tuple(ranges), tuple(harmonics)
    )

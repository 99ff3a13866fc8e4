"""Partials that a body cannot distinguish become one.

A seated body distinguishes two vibrations if their frequencies differ by a third or more (Merchel,
Altinsoy and Stamm, Internoise 2011). Closer partials are felt as one that beats. Beats that the
mapping of frequencies has made are not in the sound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.synthesis import TrackingDesign


@dataclass
class _Group:
    """Partials that are one: sums of their powers, and of power times frequency."""

    power: float
    weighted_hz: float
    strongest: float

    @property
    def hz(self) -> float:
        return self.weighted_hz / self.power

    def add(self, other: _Group) -> None:
        self.power += other.power
        self.weighted_hz += other.weighted_hz
        self.strongest = max(self.strongest, other.strongest)


def merge(
    design: TrackingDesign, hz: FloatArray, amplitude: FloatArray, sounding_hz: list[float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return groups of partials: their frequencies, amplitudes and dominance, each (groups,).

    hz (of vibration), amplitude: (partials,), ascending in frequency. sounding_hz: frequencies that
    sound, in any order; what is close to one belongs to it. A group has the energy of its partials
    and their mean frequency by energy. Its dominance is the share of its strongest one, 0 to 1.
    Two groups closer than `merge_again` times the merging distance become one. Pure.
    """
    centres = list(sounding_hz)
    gathered: list[_Group | None] = [None] * len(centres)
    for one_hz, one_amplitude in zip(hz.tolist(), amplitude.tolist(), strict=True):
        nearest, gap_hz = 0, math.inf
        for index, centre in enumerate(centres):
            if abs(one_hz - centre) < gap_hz:
                nearest, gap_hz = index, abs(one_hz - centre)
        if not centres or gap_hz > design.merging_hz(centres[nearest]):
            nearest = len(centres)
            centres.append(one_hz)
            gathered.append(None)
        power = one_amplitude * one_amplitude
        one = _Group(power, power * one_hz, power)
        group = gathered[nearest]
        if group is None:
            gathered[nearest] = one
        else:
            group.add(one)
    groups = sorted((one for one in gathered if one and one.power > 0.0), key=lambda one: one.hz)
    while len(groups) > 1:
        gaps = [
            (above.hz - below.hz) / design.merging_hz(below.hz) for below, above in pairwise(groups)
        ]
        closest = gaps.index(min(gaps))
        if gaps[closest] >= design.merge_again:
            break
        groups[closest].add(groups.pop(closest + 1))
    return (
        np.array([one.hz for one in groups]),
        np.array([math.sqrt(one.power) for one in groups]),
        np.array([one.strongest / one.power for one in groups]),
    )

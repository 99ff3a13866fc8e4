"""What a rung will be off by, estimated before it is chosen."""

import math
from typing import NamedTuple

import numpy as np

from device.rig.collocation import Bases, Linear
from device.rig.equations import EXCURSION, SPEED
from device.rig.parameters import ActuatorParameters

MARGIN = 1.5
"""The Born term times this estimates the error of what is without it."""
FLOOR = 0.01
"""Errors are shares of a block's peak, or of this share of Xmax where it moves less."""
ALL = slice(None)


class Errors(NamedTuple):
    """Errors, or peaks, of excursion, m, and acceleration, m/s^2."""

    displacement: float
    acceleration: float


class ErrorEstimate:
    """Estimates of one actuator's errors, from changes that a better rung would make."""

    def __init__(self, actuator: ActuatorParameters) -> None:
        floor_m = FLOOR * actuator.x_max_m
        self._floors = Errors(floor_m, floor_m * actuator.resonance_rad_s**2)

    def share(self, change: Errors, peaks: Errors) -> float:
        """The estimate: the larger share of its peak, with the margin; infinite if not finite."""
        largest = max(error / peak for error, peak in zip(change, peaks, strict=True))
        return MARGIN * largest if math.isfinite(largest) else math.inf

    def peaks(self, bases: Bases, path: Linear, nodes: slice = ALL) -> Errors:
        """Of the motion at some nodes, not below the floor."""
        y = np.abs(bases[0].excursion_m[nodes] + path.nodes[EXCURSION, nodes]).max()
        a = np.abs(bases[0].acceleration_m_s2[nodes] + path.node_rates[SPEED, nodes]).max()
        pairs = zip((float(y), float(a)), self._floors, strict=True)
        return Errors(*(max(peak, floor) for peak, floor in pairs))


def difference(one: Linear, other: Linear, nodes: slice = ALL) -> Errors:
    """The largest differences of two paths at some nodes."""
    y = np.abs(one.nodes[EXCURSION, nodes] - other.nodes[EXCURSION, nodes]).max()
    a = np.abs(one.node_rates[SPEED, nodes] - other.node_rates[SPEED, nodes]).max()
    return Errors(float(y), float(a))

"""Functions of the excursion in closed form, with two derivatives.

A shape is data: a few numbers that define a function of x, in metres. Its `jet` gives f, f' and f''
at each x, in arrays of the shape of x.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from device.units import FloatArray

Jet = tuple[FloatArray, FloatArray, FloatArray]
"""f, f' and f'' at each x."""


class Shape(Protocol):
    """A function f of the excursion x."""

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f'' at x."""
        ...


@dataclass(frozen=True)
class Line:
    """f = slope x."""

    slope: float

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        return self.slope * x, np.full_like(x, self.slope), np.zeros_like(x)


@dataclass(frozen=True)
class Hardening:
    """f = stiffness x^2 / 2 + rise x^4 / 4: the energy in a spring that hardens, N/m and N/m^3."""

    stiffness: float
    rise: float

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        square = x * x
        risen = self.rise * square
        first = (self.stiffness + risen) * x
        value = (0.5 * self.stiffness + 0.25 * risen) * square
        return value, first, self.stiffness + 3.0 * risen


@dataclass(frozen=True)
class Arctangent:
    """f = slope reach atan(x / reach): the flux of a coil that leaves its gap, f' = Bl."""

    slope: float  # f' at rest
    reach: float  # m, above 0: there f' has halved

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        z = x / self.reach
        share = 1.0 / (1.0 + z * z)
        first = self.slope * share
        second = first * share * z * (-2.0 / self.reach)
        return self.slope * self.reach * np.arctan(z), first, second


@dataclass(frozen=True)
class Tanh:
    """f = level (1 - share tanh(x / reach)): an inductance that falls outside the iron."""

    level: float
    share: float  # 0 to below 1
    reach: float  # m, above 0

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        t = np.tanh(x / self.reach)
        depth = self.level * self.share
        first = (t * t - 1.0) * (depth / self.reach)
        return self.level - depth * t, first, first * t * (-2.0 / self.reach)


@dataclass(frozen=True)
class Stops:
    """f = hardness / 3 indentation^3 beyond ±start: the energy in two end stops."""

    start: float  # m, above 0
    hardness: float  # N/m^2, 0 or more

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        depth = np.maximum(np.abs(x) - self.start, 0.0)
        pressed = self.hardness * depth
        force = pressed * depth
        return force * depth / 3.0, np.copysign(force, x), 2.0 * pressed

"""Functions of the excursion in closed form, with their derivatives and divided differences.

A shape is data: a few numbers that define a function of x, in metres. The divided difference
(f(b) - f(a)) / (b - a) is also exact for close a and b, and equals f'(a) for a = b; discrete
gradients are made of it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from device.units import FloatArray

Jet = tuple[FloatArray, FloatArray, FloatArray]
"""f, f' and f'' at each x."""

_SMALL = 1e-4
"""Below it atan(z)/z and tanh(z)/z are 1 - z^2/3: their series without z^4."""


class Shape(Protocol):
    """A function f of the excursion x."""

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f'' at x, in new arrays of its shape or numbers that broadcast to it."""
        ...

    def value(self, x: float) -> float:
        """f(x)."""
        ...

    def divided(self, a: float, b: float) -> float:
        """(f(b) - f(a)) / (b - a), and f'(a) where a = b."""
        ...


@dataclass(frozen=True)
class Line:
    """f = slope x."""

    slope: float

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        return self.slope * x, np.full_like(x, self.slope), np.zeros_like(x)

    def value(self, x: float) -> float:
        """f(x)."""
        return self.slope * x

    def divided(self, a: float, b: float) -> float:
        """The slope."""
        return self.slope


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

    def value(self, x: float) -> float:
        """f(x)."""
        square = x * x
        return (0.5 * self.stiffness + 0.25 * self.rise * square) * square

    def divided(self, a: float, b: float) -> float:
        """Use b^2 - a^2 = (b - a) (b + a), which avoids cancellation."""
        return (a + b) * (0.5 * self.stiffness + 0.25 * self.rise * (a * a + b * b))


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

    def value(self, x: float) -> float:
        """f(x)."""
        return self.slope * self.reach * math.atan(x / self.reach)

    def divided(self, a: float, b: float) -> float:
        """Use atan(v) - atan(u) = atan((v - u) / (1 + u v)) where that holds."""
        u, v = a / self.reach, b / self.reach
        if u * v <= -0.5:
            return self.slope * (math.atan(v) - math.atan(u)) / (v - u)
        share = 1.0 / (1.0 + u * v)
        return self.slope * share * _ratio(math.atan, (v - u) * share)


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

    def value(self, x: float) -> float:
        """f(x)."""
        return self.level * (1.0 - self.share * math.tanh(x / self.reach))

    def divided(self, a: float, b: float) -> float:
        """Use tanh v - tanh u = tanh(v - u) (1 - tanh u tanh v)."""
        u, v = a / self.reach, b / self.reach
        product = math.tanh(u) * math.tanh(v)
        return -self.level * self.share / self.reach * (1.0 - product) * _ratio(math.tanh, v - u)


@dataclass(frozen=True)
class Stops:
    """f = hardness / 3 indentation^3 beyond ±start: the energy in two end stops."""

    start: float  # m, above 0
    hardness: float  # N/m^2, 0 or more

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        depth = np.maximum(np.abs(x) - self.start, 0.0)
        if not depth.any():
            return depth, depth, depth
        pressed = self.hardness * depth
        force = pressed * depth
        return force * depth / 3.0, np.copysign(force, x), 2.0 * pressed

    def value(self, x: float) -> float:
        """f(x)."""
        depth = max(abs(x) - self.start, 0.0)
        return self.hardness / 3.0 * depth * depth * depth

    def divided(self, a: float, b: float) -> float:
        """Treat each stop separately: the quotient of cubes times that of the indentations."""
        return self._one(a, b) - self._one(-a, -b)

    def _one(self, a: float, b: float) -> float:
        u, v = max(a - self.start, 0.0), max(b - self.start, 0.0)
        if u == 0.0 and v == 0.0:
            return 0.0
        share = 1.0 if u > 0.0 and v > 0.0 else (v - u) / (b - a)
        return self.hardness / 3.0 * (v * v + u * v + u * u) * share


@dataclass(frozen=True)
class Sum:
    """The sum of several shapes."""

    shapes: tuple[Shape, ...]

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        value, first, second = self.shapes[0].jet(x)
        for shape in self.shapes[1:]:
            more = shape.jet(x)
            value, first, second = value + more[0], first + more[1], second + more[2]
        return value, first, second

    def value(self, x: float) -> float:
        """f(x)."""
        return sum(shape.value(x) for shape in self.shapes)

    def divided(self, a: float, b: float) -> float:
        """The sum of their divided differences."""
        return sum(shape.divided(a, b) for shape in self.shapes)


def _ratio(f: Callable[[float], float], z: float) -> float:
    """f(z) / z of atan or tanh, 1 at 0."""
    return f(z) / z if abs(z) > _SMALL else 1.0 - z * z / 3.0

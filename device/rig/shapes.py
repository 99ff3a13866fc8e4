"""Functions of the excursion in closed form, with their derivatives and divided differences.

A shape is data: a few numbers that define a function of x, in metres. The divided difference
(f(b) - f(a)) / (b - a) is also exact for close a and b, and equals f'(a) for a = b; discrete
gradients are made of it. Pure functions; any thread may call them.
"""

import math
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
class Polynomial:
    """f = c0 + c1 x + c2 x^2 + ... with at least one coefficient."""

    coefficients: tuple[float, ...]

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f'' by Horner's rule."""
        f = np.full_like(x, self.coefficients[-1])
        first = np.zeros_like(x)
        second = np.zeros_like(x)
        for coefficient in self.coefficients[-2::-1]:
            second = second * x + 2.0 * first
            first = first * x + f
            f = f * x + coefficient
        return f, first, second

    def value(self, x: float) -> float:
        """f(x) by Horner's rule."""
        f = 0.0
        for coefficient in reversed(self.coefficients):
            f = f * x + coefficient
        return f

    def divided(self, a: float, b: float) -> float:
        """Divide f(b) - f(a) by b - a as polynomials, without cancellation."""
        quotient, at_a = 0.0, 0.0
        for coefficient in self.coefficients[:0:-1]:
            at_a = at_a * a + coefficient
            quotient = quotient * b + at_a
        return quotient


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
        return (
            (0.5 * self.stiffness + 0.25 * risen) * square,
            first,
            self.stiffness + 3.0 * risen,
        )

    def value(self, x: float) -> float:
        """f(x)."""
        square = x * x
        return (0.5 * self.stiffness + 0.25 * self.rise * square) * square

    def divided(self, a: float, b: float) -> float:
        """Use b^2 - a^2 = (b - a) (b + a), which avoids cancellation."""
        return (a + b) * (0.5 * self.stiffness + 0.25 * self.rise * (a * a + b * b))


@dataclass(frozen=True)
class Arctangent:
    """f = slope reach atan(x / reach): the flux of a coil that leaves its gap, f' = Bl.

    The slope is f' at rest; at the reach, in m and above 0, f' has halved.
    """

    slope: float
    reach: float

    def jet(self, x: FloatArray) -> Jet:
        """f, f' and f''."""
        z = x / self.reach
        share = 1.0 / (1.0 + z * z)
        first = self.slope * share
        return (
            self.slope * self.reach * np.arctan(z),
            first,
            first * share * z * (-2.0 / self.reach),
        )

    def value(self, x: float) -> float:
        """f(x)."""
        return self.slope * self.reach * math.atan(x / self.reach)

    def divided(self, a: float, b: float) -> float:
        """Use atan(v) - atan(u) = atan((v - u) / (1 + u v)) where that holds."""
        u, v = a / self.reach, b / self.reach
        if u * v <= -0.5:
            return self.slope * (math.atan(v) - math.atan(u)) / (v - u)
        share = 1.0 / (1.0 + u * v)
        return self.slope * share * _atan_ratio((v - u) * share)


@dataclass(frozen=True)
class Tanh:
    """f = level (1 - share tanh(x / reach)): an inductance that falls as the coil leaves its iron.

    The level is f at rest; the share is 0 to below 1; the reach, in m, is above 0.
    """

    level: float
    share: float
    reach: float

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
        return -self.level * self.share / self.reach * (1.0 - product) * _tanh_ratio(v - u)


@dataclass(frozen=True)
class Stops:
    """f = hardness / 3 indentation^3 beyond ±start: the energy in two end stops.

    The start, in m, is above 0, and the hardness, in N/m^2, is 0 or more. The force grows with the
    square of the indentation, so it sets in smoothly.
    """

    start: float
    hardness: float

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


def _atan_ratio(z: float) -> float:
    """atan(z) / z, 1 at 0."""
    return math.atan(z) / z if abs(z) > _SMALL else 1.0 - z * z / 3.0


def _tanh_ratio(z: float) -> float:
    """tanh(z) / z, 1 at 0."""
    return math.tanh(z) / z if abs(z) > _SMALL else 1.0 - z * z / 3.0

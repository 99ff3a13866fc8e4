"""Laws of a coil's impedance beside its resistance, with derivatives by the parameters.

Eddy currents in the iron around a coil lower its inductance and raise its resistance with
frequency. The simplest law that explains a measurement is used.

| law | adds to R | parameters, as logs |
| --- | --- | --- |
| plain | s L | L |
| parallel | s L1 + (s L2, parallel to R2); Wright, JAES 38 (1990) | L1, L2, corner R2 / (2 pi L2) |
| power | K s^n; Leach, JAES 50 (2002) | reactance K w^n at 100 Hz, n |
| double | s L1 + two such pairs, for thick or layered iron | L1, L2, L3, both corners |
| mixed | s L1 + K s^n, for iron that neither describes alone | L1, reactance, n |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from device.identification.recording import ComplexArray
from device.units import FloatArray

REFERENCE_HZ = 100.0
"""At this frequency the reactance K w^n of a power law is a parameter, as K has no usable unit."""

Impedance = tuple[ComplexArray, list[ComplexArray]]
"""The impedance, (bins,), and its derivative by each parameter."""


@dataclass(frozen=True)
class CoilLaw:
    """One law. Its parameters are amplitudes, then those that give the shape."""

    name: str
    impedance: Callable[[FloatArray, FloatArray], Impedance]
    limits: tuple[tuple[float, float], ...]  # lowest and highest logarithm of each parameter
    shapes: tuple[tuple[float, ...], ...] = ((),)  # starts for the logarithms of the last ones

    @property
    def parameters(self) -> int:
        """Their number."""
        return len(self.limits)

    def columns(self, f: FloatArray, shape: tuple[float, ...]) -> list[ComplexArray]:
        """Return the impedance of each amplitude of 1, for one of `shapes`."""
        linear = self.parameters - len(shape)
        return self.impedance(f, np.array([0.0] * linear + list(shape)))[1][:linear]


def _plain(f: FloatArray, p: FloatArray) -> Impedance:
    inductive = 1j * math.tau * f * math.exp(p[0])
    return inductive, [inductive]


def _parallel(f: FloatArray, p: FloatArray) -> Impedance:
    main, inner = (1j * math.tau * f * math.exp(log) for log in p[:2])
    turn = 1j * f / math.exp(p[2])
    eddy = inner / (1.0 + turn)
    return main + eddy, [main, eddy, eddy * turn / (1.0 + turn)]


def _double(f: FloatArray, p: FloatArray) -> Impedance:
    first, (d_main, d_one, d_corner) = _parallel(f, p[[0, 1, 3]])
    second, (_, d_two, d_other) = _parallel(f, np.array([-np.inf, p[2], p[4]]))
    return first + second, [d_main, d_one, d_two, d_corner, d_other]


def _power(f: FloatArray, p: FloatArray) -> Impedance:
    exponent = math.exp(p[1])
    log: ComplexArray = np.log(np.maximum(f, 1e-9) / REFERENCE_HZ) + 0.5j * np.pi
    z = np.asarray(math.exp(p[0]) * np.exp(exponent * log), np.complex128)
    return z, [z, z * exponent * log]


def _mixed(f: FloatArray, p: FloatArray) -> Impedance:
    main, d_main = _plain(f, p[:1])
    rest, d_rest = _power(f, p[1:])
    return main + rest, d_main + d_rest


_L, _X, _N = (math.log(1e-7), 2.0), (math.log(1e-4), math.log(1e4)), (math.log(0.45), 0.0)
_CORNER = math.log(20.0), math.log(5e3)
_CORNERS = tuple((log,) for log in np.log([40.0, 90.0, 200.0, 450.0, 1000.0]))
_BOTH = tuple(tuple(np.log(pair)) for pair in ((40.0, 200.0), (60.0, 600.0), (150.0, 1000.0)))
_EXPONENTS = tuple((log,) for log in np.log([0.5, 0.6, 0.7, 0.8, 0.9]))


PLAIN = CoilLaw("plain", _plain, (_L,))
PARALLEL = CoilLaw("parallel", _parallel, (_L, _L, _CORNER), _CORNERS)
POWER = CoilLaw("power", _power, (_X, _N), _EXPONENTS)
DOUBLE = CoilLaw("double", _double, (_L, _L, _L, _CORNER, _CORNER), _BOTH)
MIXED = CoilLaw("mixed", _mixed, (_L, _X, _N), _EXPONENTS)
LAWS = PLAIN, POWER, PARALLEL, MIXED, DOUBLE


def closest_parallel(
    law: CoilLaw, logs: FloatArray, covariance: FloatArray, low_hz: float, high_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Return parameters of PARALLEL, and their covariance, closest to a law between frequencies."""
    f = np.geomspace(low_hz, high_hz, 60)
    limits = tuple(np.transpose(PARALLEL.limits))

    def solved(p: FloatArray, start: FloatArray) -> FloatArray:
        aim = law.impedance(f, p)[0]

        def left(q: FloatArray) -> FloatArray:
            e = (PARALLEL.impedance(f, q)[0] - aim) / np.abs(aim).max()
            return np.concatenate([e.real, e.imag])

        return np.asarray(least_squares(left, start, bounds=limits, xtol=1e-12, ftol=1e-12).x)

    size = math.log(float(np.abs(law.impedance(f, logs)[0]).max()) / (math.tau * high_hz))
    starts = [np.array([size - 1.0, size, corner]) for (corner,) in _CORNERS[1:4]]
    aim = law.impedance(f, logs)[0]
    tried = [solved(logs, start) for start in starts]
    best = min(tried, key=lambda q: float(np.sum(np.abs(PARALLEL.impedance(f, q)[0] - aim) ** 2)))
    step = 1e-3
    slopes = [
        (solved(logs + d, best) - solved(logs - d, best)) / (2.0 * step)
        for d in step * np.eye(len(logs))
    ]
    change = np.column_stack(slopes)
    return best, change @ covariance @ change.T

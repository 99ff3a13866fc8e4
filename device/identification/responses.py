"""Frequency responses and coil impedances, with derivatives by parameter. Pure functions.

All parameters except delays are logarithms. These are well scaled, keep physical values positive,
and have relative intervals. s = j w. Eddy currents in the iron around a coil lower its inductance
and raise its resistance with frequency. `impedance.py` selects the law that fits best.

| law | adds to R | parameters, as logs |
| --- | --- | --- |
| plain | s L | L |
| parallel | s L1 + (s L2, parallel to R2); Wright, JAES 38 (1990) | L1, L2, corner R2 / (2 pi L2) |
| power | K s^n; Leach, JAES 50 (2002) | reactance K w^n at 100 Hz, n |
| double | s L1 + two parallel pairs, for thick or layered iron | L1, L2, L3, both corners |
| mixed | s L1 + K s^n, for iron that fits neither law alone | L1, reactance, n |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from device.identification.recording import ComplexArray
from device.units import FloatArray

# H, (bins,), and its derivatives by the parameters, (bins, parameters)
Response = tuple[ComplexArray, ComplexArray]
REFERENCE_HZ = 100.0  # the parameter for K is the reactance K w^n here, as K's unit depends on n
Impedance = tuple[ComplexArray, list[ComplexArray]]  # (bins,); its derivative by each parameter


def pair(f: FloatArray, log_hz: float, log_q: float) -> Response:
    """Return 1 - r^2 + j r / Q with r = f / f0, and its derivatives by the logs of f0 and Q."""
    r = f / math.exp(log_hz)
    damped: ComplexArray = 1j * r / math.exp(log_q)
    return np.asarray(1.0 - r**2 + damped), np.column_stack([2.0 * r**2 - damped, -damped])


@dataclass(frozen=True)
class Factor:
    """One factor of a response: h, (bins,), and the derivatives of its logarithm."""

    parameters: int
    of: Callable[[FloatArray, FloatArray], Response]


def product(*factors: Factor) -> Callable[[FloatArray, FloatArray], Response]:
    """Return a model: the product of factors. Its argument p holds their parameters in order."""

    def model(f: FloatArray, p: FloatArray) -> Response:
        h, slopes, first = np.ones(len(f), np.complex128), [], 0
        for factor in factors:
            one, d_log = factor.of(f, p[first : first + factor.parameters])
            h, first = h * one, first + factor.parameters
            slopes.append(d_log)
        return h, h[:, None] * np.column_stack(slopes)

    return model


def _mode(f: FloatArray, p: FloatArray) -> Response:
    d, dd = pair(f, p[1], p[2])
    r2 = -((f / math.exp(p[1])) ** 2)
    slopes = [np.ones_like(d), -2.0 - dd[:, 0] / d, -dd[:, 1] / d]
    return math.exp(p[0]) * r2 / d, np.column_stack(slopes)


def _gain(f: FloatArray, p: FloatArray) -> Response:
    return np.full(len(f), math.exp(p[0]), np.complex128), np.ones((len(f), 1), np.complex128)


def _lag(f: FloatArray, p: FloatArray) -> Response:
    turn = 1j * math.tau * f * math.exp(p[0])
    return np.asarray(1.0 / (1.0 + turn)), (-turn / (1.0 + turn))[:, None]


def _eddy(f: FloatArray, p: FloatArray) -> Response:
    above, d_above = _lag(f, p[:1])
    below, d_below = _lag(f, p[1:])
    return below / above, np.column_stack([-d_above, d_below])


DELAY_S = 1e-3  # unit of a delay in s


def _delay(f: FloatArray, p: FloatArray) -> Response:
    rate: ComplexArray = -1j * math.tau * f * DELAY_S
    return np.exp(rate * p[0]), rate[:, None]


def _seat(f: FloatArray, p: FloatArray) -> Response:
    above, d_above = pair(f, p[0], p[1])
    below, d_below = pair(f, p[2], p[3])
    slopes = np.column_stack([d_above / above[:, None], -d_below / below[:, None]])
    slopes[:, 0] += 2.0
    slopes[:, 2] -= 2.0
    return above / below * math.exp(2.0 * (p[0] - p[2])), slopes


# acceleration per force, S (s/w0)^2 / pair: logs of S (the sensitivity above f0), f0 and Q
MODE = Factor(3, _mode)
GAIN = Factor(1, _gain)  # log of a gain
LAG = Factor(1, _lag)  # the coil's lag 1 / (1 + s T) under voltage drive: log of T
DELAY = Factor(1, _delay)  # a delay in ms, which is not a logarithm
EDDY = Factor(2, _eddy)  # of eddy currents, on LAG: (1 + s T1) / (1 + s T2), logs of T1 and T2
SEAT = Factor(4, _seat)  # a moving frame: logs of f and Q of two zeros, then of two poles


def high_pass(known_hz: float) -> Factor:
    """Return a factor: a high-pass, divided by a high-pass with the corner frequency known_hz.

    Both are second-order Butterworth filters, as in `device.rig.electronics.Band`. If known_hz is
    0, there is no divisor. The factor's parameter is the log of the first corner in Hz.
    """

    def of(f: FloatArray, p: FloatArray) -> Response:
        h, d_log = _butterworth(f, p[0])
        return (h / _butterworth(f, math.log(known_hz))[0] if known_hz else h), d_log

    return Factor(1, of)


def _butterworth(f: FloatArray, log_hz: float) -> Response:
    d, dd = pair(f, log_hz, -0.5 * math.log(2.0))
    return -((f / math.exp(log_hz)) ** 2) / d, (-2.0 - dd[:, 0] / d)[:, None]


def load(admittance_s: ComplexArray) -> Factor:
    """Return a factor: load voltage / open-circuit voltage, for the log of the source resistance.

    admittance_s: admittance of the load in siemens, (bins,).
    """

    def of(_: FloatArray, p: FloatArray) -> Response:
        part = math.exp(p[0]) * admittance_s
        return 1.0 / (1.0 + part), (-part / (1.0 + part))[:, None]

    return Factor(1, of)


@dataclass(frozen=True)
class CoilLaw:
    """A law of coil impedance. Its parameters are amplitudes, followed by shape parameters."""

    name: str
    impedance: Callable[[FloatArray, FloatArray], Impedance]
    limits: tuple[tuple[float, float], ...]  # lowest and highest logarithm of each parameter
    shapes: tuple[tuple[float, ...], ...] = ((),)  # start values for the logs of shape parameters

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return len(self.limits)

    def columns(self, f: FloatArray, shape: tuple[float, ...]) -> list[ComplexArray]:
        """Return the impedance per unit of each linear parameter. shape: shape parameters."""
        linear = self.parameters - len(shape)
        return self.impedance(f, np.array([*[0.0] * linear, *shape]))[1][:linear]


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
    """Return parameters of PARALLEL that approximate a law in a band, and their covariance."""
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
    shifts = step * np.eye(len(logs))
    rises = [solved(logs + shift, best) - solved(logs - shift, best) for shift in shifts]
    change = np.column_stack(rises) / (2.0 * step)
    return best, change @ covariance @ change.T


def admittance(f: FloatArray, p: FloatArray, law: CoilLaw) -> Response:
    """Return current per voltage at the coil: 1 / (Re + coil + Res (s / w0 / Qms) / pair).

    coil: impedance of `law`. pair: see `pair`. p: logs of Re, f0, Qms, Res and the parameters of
    `law`; with a seat, also those of SEAT. Res = Bl^2 Qms / (m w0) is the rise of the impedance at
    the resonance (Thiele, Small).
    """
    d, dd = pair(f, p[1], p[2])
    rest = 4 + law.parameters
    damped = 1j * f / math.exp(p[1] + p[2])
    motional = math.exp(p[3]) * damped / d
    moves = [motional * (-1.0 - dd[:, 0] / d), motional * (-1.0 - dd[:, 1] / d), motional]
    held = []
    if len(p) > rest:
        more, d_log = SEAT.of(f, p[rest:])
        moves = [slope * more for slope in moves]
        motional = motional * more
        held = list((motional[:, None] * d_log).T)
    coil, d_coil = law.impedance(f, p[4:rest])
    resistance = np.full_like(d, math.exp(p[0]))
    z = resistance + coil + motional
    return 1.0 / z, -np.column_stack([resistance, *moves, *d_coil, *held]) / (z**2)[:, None]

"""Frequency responses made of factors, with derivatives by their parameters. Pure functions.

All parameters are logarithms: each is well scaled and stays positive, and its interval is relative.
s = j w.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from device.identification.coil_laws import CoilLaw
from device.identification.recording import ComplexArray
from device.units import FloatArray

Response = tuple[ComplexArray, ComplexArray]
"""H, (bins,), and its derivatives by the parameters, (bins, parameters)."""


def pair(f: FloatArray, log_hz: float, log_q: float) -> Response:
    """Return 1 - r^2 + j r / Q with r = f / f0: two poles or zeros, 1 at 0 Hz."""
    r = f / math.exp(log_hz)
    damped: ComplexArray = 1j * r / math.exp(log_q)
    return np.asarray(1.0 - r**2 + damped), np.column_stack([2.0 * r**2 - damped, -damped])


@dataclass(frozen=True)
class Factor:
    """One factor of a response: h, (bins,), and the derivatives of its logarithm."""

    parameters: int
    of: Callable[[FloatArray, FloatArray], Response]


def product(*factors: Factor) -> Callable[[FloatArray, FloatArray], Response]:
    """Return the model that multiplies factors; p holds their parameters in this order."""

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


DELAY_S = 1e-3
"""The unit of a delay."""


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


MODE = Factor(3, _mode)
"""Acceleration for a force: S (s/w0)^2 / pair. Logs of S, the sensitivity above f0, f0 and Q."""
GAIN = Factor(1, _gain)
"""A gain, as log."""
LAG = Factor(1, _lag)
"""The coil's lag 1 / (1 + s T) under voltage drive: log of T."""
DELAY = Factor(1, _delay)
"""A delay in ms, which is not a logarithm."""
EDDY = Factor(2, _eddy)
"""The effect of eddy currents on the lag: (1 + s T1) / (1 + s T2), logs of both."""
SEAT = Factor(4, _seat)
"""A moving frame: two zeros over two poles, 1 well above them.

Logs of the zeros' frequency and Q, then of the poles'. The zeros are the frame's own mode.
"""


def high_pass(known_hz: float) -> Factor:
    """Return a high-pass divided by one with a known corner; its parameter is the log of Hz.

    Both are Butterworth of second order, as `device.rig.electronics.Band`; 0 is none.
    """

    def of(f: FloatArray, p: FloatArray) -> Response:
        h, d_log = _butterworth(f, p[0])
        return (h / _butterworth(f, math.log(known_hz))[0] if known_hz else h), d_log

    return Factor(1, of)


def _butterworth(f: FloatArray, log_hz: float) -> Response:
    d, dd = pair(f, log_hz, -0.5 * math.log(2.0))
    r2 = -((f / math.exp(log_hz)) ** 2)
    return r2 / d, (-2.0 - dd[:, 0] / d)[:, None]


def load(admittance_s: ComplexArray) -> Factor:
    """Return the loss of a source impedance at a load, (bins,); its parameter is the log of ohm."""

    def of(_: FloatArray, p: FloatArray) -> Response:
        part = math.exp(p[0]) * admittance_s
        return 1.0 / (1.0 + part), (-part / (1.0 + part))[:, None]

    return Factor(1, of)


def admittance(f: FloatArray, p: FloatArray, law: CoilLaw) -> Response:
    """Return current for voltage at the coil: 1 / (Re + coil + Res (s / w0 / Qms) / pair).

    p holds the logs of Re, f0, Qms, Res, the parameters of the coil's law[, the seat's four].
    Res = Bl^2 Qms / (m w0) is the rise of the impedance at the resonance (Thiele, Small).
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
    slopes = np.column_stack([resistance, *moves, *d_coil, *held])
    return 1.0 / z, -slopes / (z**2)[:, None]

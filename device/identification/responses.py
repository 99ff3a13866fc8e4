"""Frequency responses made of factors, with derivatives by their parameters. Pure functions.

All parameters are logarithms: each is well scaled and stays positive, and its interval is relative.
s = j w.
"""

import math

import numpy as np

from device.identification.recording import ComplexArray
from device.units import FloatArray

Response = tuple[ComplexArray, ComplexArray]
"""H, (bins,), and its derivatives by the parameters, (bins, parameters)."""


def pair(f: FloatArray, log_hz: float, log_q: float) -> Response:
    """Return 1 - r^2 + j r / Q with r = f / f0: two poles or zeros, 1 at 0 Hz."""
    r = f / math.exp(log_hz)
    damped: ComplexArray = 1j * r / math.exp(log_q)
    return np.asarray(1.0 - r**2 + damped), np.column_stack([2.0 * r**2 - damped, -damped])


def seat(f: FloatArray, p: FloatArray) -> Response:
    """Return the factor of a moving frame: two zeros over two poles, 1 well above them.

    p holds the logs of the zeros' frequency and Q, then of the poles'. The zeros are the frame's
    own mode.
    """
    above, d_above = pair(f, p[0], p[1])
    below, d_below = pair(f, p[2], p[3])
    ratio = above / below * math.exp(2.0 * (p[0] - p[2]))
    slopes = np.column_stack([d_above / above[:, None], -d_below / below[:, None]])
    slopes[:, 0] += 2.0
    slopes[:, 2] -= 2.0
    return ratio, slopes * ratio[:, None]


def acceleration(f: FloatArray, p: FloatArray, *, electrical: bool) -> Response:
    """Return acceleration for a drive: S (s/w0)^2 / pair / lag, with the seat's factor if in p.

    p holds the logs of S, f0, Q[, T][, the seat's four]. The coil's lag T applies to voltage drive.
    S is the sensitivity above the resonance.
    """
    d, dd = pair(f, p[1], p[2])
    r2 = -((f / math.exp(p[1])) ** 2)
    h = math.exp(p[0]) * r2 / d
    slopes = [np.ones_like(d), -2.0 - dd[:, 0] / d, -dd[:, 1] / d]
    rest = 3
    if electrical:
        turn = 1j * math.tau * f * math.exp(p[3])
        h = h / (1.0 + turn)
        slopes.append(-turn / (1.0 + turn))
        rest = 4
    if len(p) > rest:
        more, d_more = seat(f, p[rest:])
        h = h * more
        slopes += list((d_more / more[:, None]).T)
    return h, h[:, None] * np.column_stack(slopes)


DELAY_S = 1e-3
"""The unit of the delay in `delayed_acceleration`."""


def delayed_acceleration(f: FloatArray, p: FloatArray) -> Response:
    """Return `acceleration` for a voltage, delayed by p[4] ms, which is not a logarithm.

    p holds the logs of S, f0, Q, T, then the delay[, the seat's four].
    """
    h, slopes = acceleration(f, np.delete(p, 4), electrical=True)
    rate: ComplexArray = -1j * math.tau * f * DELAY_S
    h = h * np.exp(rate * p[4])
    slopes = slopes * np.exp(rate * p[4])[:, None]
    return h, np.insert(slopes, 4, rate * h, axis=1)


def admittance(f: FloatArray, p: FloatArray) -> Response:
    """Return current for voltage at the coil: 1 / (Re + s Le + Res (s / w0 / Qms) / pair).

    p holds the logs of Re, Le, f0, Qms, Res[, the seat's four]. Res = Bl^2 Qms / (m w0) is the rise
    of the impedance at the resonance (Thiele, Small).
    """
    d, dd = pair(f, p[2], p[3])
    resistance, inductance = math.exp(p[0]), math.exp(p[1])
    damped = 1j * f / math.exp(p[2] + p[3])
    motional = math.exp(p[4]) * damped / d
    slopes = [
        np.full_like(d, resistance),
        1j * math.tau * f * inductance,
        motional * (-1.0 - dd[:, 0] / d),
        motional * (-1.0 - dd[:, 1] / d),
        motional,
    ]
    if len(p) > 5:
        more, d_more = seat(f, p[5:])
        slopes[2:5] = [slope * more for slope in slopes[2:5]]
        slopes += list((motional[:, None] * d_more).T)
        motional = motional * more
    z = resistance + 1j * math.tau * f * inductance + motional
    return 1.0 / z, -np.column_stack(slopes) / (z**2)[:, None]

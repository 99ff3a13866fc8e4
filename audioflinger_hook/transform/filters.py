"""Filter design with the formulas of `scipy.signal`, without an import of SciPy."""

from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from audioflinger_hook.transform.arrays import ComplexArray, FloatArray


class Roots(NamedTuple):
    """Zeros, poles and gain of a filter. Complex zeros and poles are in conjugate pairs."""

    zeros: ComplexArray
    poles: ComplexArray
    gain: float


_ZEROS = np.array([3.1568114238976115j, 1.3622529336712117j, 1.1443400815042173j])
_POLES = np.array(
    [
        -0.38503679665658613 - 0.4114744502967013j,
        -0.15287525108369296 - 0.8792730574438216j,
        -0.03251589915459846 - 1.0065336408258416j,
    ]
)

# Prototypes: analogue low-passes with a pass band up to 1 rad/s. `BUTTERWORTH` has order 2.
_NONE = np.empty(0, complex)
BUTTERWORTH = Roots(_NONE, -np.exp(0.25j * np.pi * np.array([-1.0, 1.0])), 1.0)
BUTTERWORTH_1 = Roots(_NONE, np.array([-1.0 + 0.0j]), 1.0)
BUTTERWORTH_5 = Roots(_NONE, -np.exp(0.2j * np.pi * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])), 1.0)
ELLIPTIC_6 = Roots(  # `scipy.signal.ellipap(6, 0.5, 40.0)`
    np.concatenate((_ZEROS, _ZEROS.conj())),
    np.concatenate((_POLES, _POLES.conj())),
    0.009999999999999957,
)


def low_pass(prototype: Roots, edge_hz: float, samplerate: float) -> Roots:
    """Return the digital low-pass with the band edge `edge_hz`, which is below samplerate / 2."""
    zeros, poles, gain = prototype
    edge = _warped(edge_hz, samplerate)
    return _digital(Roots(edge * zeros, edge * poles, gain * edge ** (poles.size - zeros.size)))


def high_pass(prototype: Roots, edge_hz: float, samplerate: float) -> Roots:
    """Return the digital high-pass with the band edge `edge_hz`, which is below samplerate / 2."""
    zeros, poles, gain = prototype
    edge = _warped(edge_hz, samplerate)
    at_zero = np.zeros(poles.size - zeros.size)
    turned = gain * np.real(np.prod(-zeros) / np.prod(-poles))
    return _digital(Roots(np.concatenate((edge / zeros, at_zero)), edge / poles, float(turned)))


def band_pass(prototype: Roots, low_hz: float, high_hz: float, samplerate: float) -> Roots:
    """Return the digital band-pass. Its order is twice the order of the prototype."""
    low, high = _warped(low_hz, samplerate), _warped(high_hz, samplerate)
    width, centre = high - low, float(np.sqrt(low * high))
    zeros, poles = (_split(roots * width / 2, centre) for roots in prototype[:2])
    degree = prototype.poles.size - prototype.zeros.size
    zeros = np.concatenate((zeros, np.zeros(degree)))
    return _digital(Roots(zeros, poles, prototype.gain * width**degree))


def response(b: FloatArray, a: FloatArray, hz: FloatArray, samplerate: float) -> ComplexArray:
    """Return the frequency response at `hz`, (frequencies,). b, a: coefficients of the filter."""
    delay = np.exp(-1j * (2.0 * np.pi * hz / samplerate))
    return np.asarray(polyval(delay, b, tensor=False) / polyval(delay, a, tensor=False))


def response_of_sections(sections: FloatArray, hz: FloatArray, samplerate: float) -> ComplexArray:
    """Return the frequency response at `hz` of a filter of second-order sections, (sections, 6)."""
    passed = [response(row[:3], row[3:], hz, samplerate) for row in sections]
    return np.asarray(np.prod(passed, axis=0))


def lowest_bins(samples: FloatArray, bins: int, length: int) -> ComplexArray:
    """Return the lowest `bins` bins of the FFT of samples zero-padded to `length`, (bins,).

    With the chirp-z transform, the computing time is nearly independent of `length`.
    """
    count = samples.size
    steps = np.arange(max(bins, count), dtype=np.float64)
    chirp = np.exp(-(1j * np.pi * (bins * bins / (length * bins)) * steps**2) / bins)
    size = fast_length(count + bins - 1, (2, 3, 5, 7, 11))
    turn = np.fft.fft(1.0 / np.concatenate((chirp[count - 1 : 0 : -1], chirp[:bins])), size)
    found = np.fft.ifft(turn * np.fft.fft(samples * chirp[:count], size))
    return np.asarray(found[count - 1 : count + bins - 1] * chirp[:bins])


def fast_length(least: int, primes: tuple[int, ...] = (2, 3, 5)) -> int:
    """Return the smallest length, `least` or more, that has no prime factors except `primes`."""
    length = max(1, least)
    while True:
        rest = length
        for prime in primes:
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return length
        length += 1


def _warped(hz: float, samplerate: float) -> float:
    """Return the prewarped frequency in rad/s for a bilinear transform at a samplerate of 2 Hz."""
    return float(4.0 * np.tan(np.pi * (hz / (samplerate / 2)) / 2.0))


def _split(roots: ComplexArray, centre: float) -> ComplexArray:
    away = np.sqrt(roots**2 - centre**2)
    return np.concatenate((roots + away, roots - away))


def _digital(analogue: Roots) -> Roots:
    """Return the bilinear transform of an analogue filter at a samplerate of 2 Hz."""
    zeros, poles, gain = analogue
    return Roots(
        np.concatenate(((4.0 + zeros) / (4.0 - zeros), -np.ones(poles.size - zeros.size))),
        (4.0 + poles) / (4.0 - poles),
        float(gain * np.real(np.prod(4.0 - zeros) / np.prod(4.0 - poles))),
    )

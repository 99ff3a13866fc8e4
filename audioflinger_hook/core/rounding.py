"""Rounds designs so that their bits do not depend on the machine that computes them.

The last bits of sines, logarithms and least squares differ between math libraries. Rounding drops
these bits. `round_filter` rounds poles and zeros instead of coefficients. In a filter of high
order, small errors of coefficients would move the poles too far.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from device.units import FloatArray

NUMBER_BITS = 40  # significant bits of a number
TABLE_BITS = 32  # significant bits of an entry of a table
# An entry near 0 may be a difference of large numbers. Therefore each entry loses its bits that are
# more than this many places below the first bit of the table's largest entry.
TABLE_FLOOR_BITS = 38
ROOT_BITS = 40  # fractional bits of a pole or zero


def round_number(number: float, bits: int = NUMBER_BITS) -> float:
    """Round to `bits` significant bits. Zero, infinity and NaN do not change."""
    fraction, exponent = math.frexp(number)
    if not math.isfinite(number):
        return number
    return math.ldexp(round(math.ldexp(fraction, bits)), exponent - bits)


def round_table(table: FloatArray) -> FloatArray:
    """Round each entry of a finite table to at most TABLE_BITS significant bits."""
    _, exponents = np.frexp(table)
    largest = int(exponents.max(initial=-1000, where=table != 0.0))
    last = np.maximum(exponents - TABLE_BITS, largest - TABLE_FLOOR_BITS)
    rounded: FloatArray = np.ldexp(np.rint(np.ldexp(table, -last)), last) + 0.0
    return rounded


def round_section(section: Any, exact: Sequence[str] = ()) -> Any:
    """Return a copy of a dataclass with rounded float and array fields, except those in `exact`."""
    changes: dict[str, Any] = {}
    for item in fields(section):
        value = getattr(section, item.name)
        if item.type is float and item.name not in exact:
            changes[item.name] = round_number(float(value))
        elif item.type == FloatArray and item.name not in exact:
            changes[item.name] = round_table(value)
    return replace(section, **changes)


def round_filter(
    zeros: Iterable[complex], poles: Iterable[complex], gain: float
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients b and a of a digital filter, after rounding its gain, zeros and poles."""
    b = round_number(float(gain)) * np.array(_polynomial(zeros))
    return b, np.array(_polynomial(poles))


def round_sections(zeros: Iterable[complex], poles: Iterable[complex], gain: float) -> FloatArray:
    """Return a digital filter as second-order sections, (n, 6), from rounded zeros and poles.

    Complex roots must be in conjugate pairs. Complex poles of high frequency share a section with
    complex zeros of low frequency. The first section includes the gain.
    """
    of_poles, of_zeros = _pairs(poles), _pairs(zeros)
    complex_zeros = sum(abs(pair[0].imag) > 0.0 for pair in of_zeros)
    of_zeros[:complex_zeros] = of_zeros[:complex_zeros][::-1]
    rows = np.zeros((len(of_poles), 6))
    for row, on_zeros, on_poles in zip(rows, of_zeros, of_poles, strict=True):
        b, a = round_filter(on_zeros, on_poles, gain)
        row[: b.size], row[3 : 3 + a.size] = b, a
        gain = 1.0
    return rows


def _pairs(roots: Iterable[complex]) -> list[list[complex]]:
    """Return conjugate pairs by rising frequency, then pairs of real roots."""
    given = [complex(one) for one in roots]
    near_real = [one for one in given if abs(one.imag) < 2.0**-ROOT_BITS]
    upper = sorted((one for one in given if one.imag >= 2.0**-ROOT_BITS), key=lambda one: -one.real)
    real = sorted((complex(one.real) for one in near_real), key=lambda one: one.real)
    return [[one, one.conjugate()] for one in upper] + [
        real[at : at + 2] for at in range(0, len(real), 2)
    ]


def _polynomial(roots: Iterable[complex]) -> list[float]:
    """Return the coefficients of prod(1 - root / z) for rounded roots, equal on every machine."""
    found, scale = [1.0], 2.0**ROOT_BITS
    for root in sorted((complex(one) for one in roots), key=lambda one: (one.real, abs(one.imag))):
        real, imaginary = (round(part * scale) / scale for part in (root.real, abs(root.imag)))
        if imaginary == 0.0:
            found = _product(found, [1.0, -real])
        elif root.imag > 0.0:
            found = _product(found, [1.0, -2.0 * real, real * real + imaginary * imaginary])
    return found


def _product(one: list[float], other: list[float]) -> list[float]:
    found = [0.0] * (len(one) + len(other) - 1)
    for at, left in enumerate(one):
        for shift, right in enumerate(other):
            found[at + shift] += left * right
    return found

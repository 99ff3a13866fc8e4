"""Designs whose bits do not depend on the machine that makes them.

Libraries of other machines round sines, logarithms and least squares in another way, by a few units
in the last place. A design keeps fewer bits than these agree on. Filters are rounded as poles and
zeros, since the coefficients of a high order amplify every error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from device.units import FloatArray

NUMBER_BITS = 40  # significant bits of a number
TABLE_BITS = 32  # significant bits of an entry of a table
# An entry near 0 may be a difference of large numbers, so its last bit is at most this far below
# the table's largest entry.
TABLE_FLOOR_BITS = 38
ROOT_BITS = 40  # bits after the point of a pole or zero


def round_number(number: float, bits: int = NUMBER_BITS) -> float:
    """Return a number with this many significant bits; 0 and what is not finite stay."""
    fraction, exponent = math.frexp(number)
    if not math.isfinite(number):
        return number
    return math.ldexp(round(math.ldexp(fraction, bits)), exponent - bits)


def round_table(table: FloatArray) -> FloatArray:
    """Return a finite table with at most `TABLE_BITS` significant bits in each entry."""
    _, exponents = np.frexp(table)
    largest = int(exponents.max(initial=-1000, where=table != 0.0))
    last = np.maximum(exponents - TABLE_BITS, largest - TABLE_FLOOR_BITS)
    rounded: FloatArray = np.ldexp(np.rint(np.ldexp(table, -last)), last) + 0.0
    return rounded


def round_section(section: Any, exact: Sequence[str] = ()) -> Any:
    """Return a section of a design, a dataclass, rounded but for the fields named in `exact`."""
    changes: dict[str, Any] = {}
    for item in fields(section):
        value = getattr(section, item.name)
        if item.type == "float" and item.name not in exact:
            changes[item.name] = round_number(float(value))
        elif item.type == "FloatArray" and item.name not in exact:
            changes[item.name] = round_table(value)
    return replace(section, **changes)


def round_filter(
    zeros: Iterable[complex], poles: Iterable[complex], gain: float
) -> tuple[FloatArray, FloatArray]:
    """Return b and a of a digital filter from rounded roots, in conjugate pairs, and a gain."""
    b = round_number(float(gain)) * np.array(_polynomial(zeros))
    return b, np.array(_polynomial(poles))


def round_sections(zeros: Iterable[complex], poles: Iterable[complex], gain: float) -> FloatArray:
    """Return a digital filter as second-order sections (sections, 6), from its rounded roots.

    zeros, poles: as many of one as of the other, complex ones in conjugate pairs; the first section
    has the gain. A pole with a high Q is in one section with the lowest of the zeros.
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
    """Return roots in conjugate pairs by frequency, then real ones in twos."""
    given = [complex(one) for one in roots]
    near_real = [one for one in given if abs(one.imag) < 2.0**-ROOT_BITS]
    upper = sorted((one for one in given if one.imag >= 2.0**-ROOT_BITS), key=lambda one: -one.real)
    real = sorted((complex(one.real) for one in near_real), key=lambda one: one.real)
    return [[one, one.conjugate()] for one in upper] + [
        real[at : at + 2] for at in range(0, len(real), 2)
    ]


def _polynomial(roots: Iterable[complex]) -> list[float]:
    """Return the coefficients of prod(1 - root / z), in sums and products of floats alone.

    NumPy's products of arrays may join a product and a sum in one rounding on some processors.
    """
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

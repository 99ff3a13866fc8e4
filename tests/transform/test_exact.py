"""The elementary functions of the C code, against decimal arithmetic of 60 digits."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest

from tests.support.kernel_probes import probes

pytestmark = pytest.mark.skipif(probes is None, reason="the probes need a C compiler")

CASES = 4_000
RNG_SEED = 35


def sine(x: Decimal) -> Decimal:
    """Return the sum of the sine's series for |x| up to 1."""
    term = total = x
    for n in range(2, 60, 2):
        term *= -x * x / (n * (n + 1))
        total += term
    return total


def cosine(x: Decimal) -> Decimal:
    """Return the sum of the cosine's series for |x| up to 1."""
    term = total = Decimal(1)
    for n in range(1, 60, 2):
        term *= -x * x / (n * (n + 1))
        total += term
    return total


def tangent(x: Decimal) -> Decimal:
    """Return the hyperbolic tangent."""
    grown = (2 * x).exp()
    return (grown - 1) / (grown + 1)


def log2(x: Decimal) -> Decimal:
    """Return the logarithm to base 2."""
    return x.ln() / Decimal(2).ln()


def uniform(low: float, high: float) -> np.ndarray:
    """Return numbers in a range, and its middle."""
    rng = np.random.default_rng(RNG_SEED)
    return np.append(rng.uniform(low, high, CASES), (low + high) / 2.0)


def spread(low: float, high: float) -> np.ndarray:
    """Return numbers of all sizes between two powers of 10, and many near 1."""
    rng = np.random.default_rng(RNG_SEED)
    sizes = 10.0 ** rng.uniform(low, high, CASES)
    return np.concatenate([sizes, rng.uniform(0.5, 2.0, CASES), 1.0 + rng.normal(0, 1e-6, CASES)])


Function = Callable[[Decimal], Decimal]

FUNCTIONS: dict[str, tuple[Function, np.ndarray, float]] = {
    "exact_exp": (Decimal.exp, np.concatenate([uniform(-700, 700), uniform(-1, 1)]), 1.0),
    "exact_log": (Decimal.ln, spread(-300, 300), 1.0),
    "exact_log2": (log2, spread(-300, 300), 2.0),
    "exact_log10": (Decimal.log10, spread(-300, 300), 2.0),
    # x y is rounded before exp, which makes an error of |x y| half units.
    "exact_amplitude": (lambda x: Decimal(10) ** (x / 20), uniform(-120, 40), 16.0),
    "power_035": (lambda x: x ** Decimal("0.35"), spread(-6, 3), 8.0),
    "exact_tanh": (tangent, np.concatenate([uniform(-3, 3), uniform(-0.2, 0.2)]), 3.0),
    "exact_sin": (sine, uniform(-np.pi / 4, np.pi / 4), 1.0),
    "exact_cos": (cosine, uniform(-np.pi / 4, np.pi / 4), 1.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_error_is_a_few_units_in_the_last_place(name):
    function, numbers, allowed = FUNCTIONS[name]
    found = numbers.copy()
    getattr(probes, name)(found)
    with localcontext() as context:
        context.prec = 60
        true = [function(Decimal(float(number))) for number in numbers]
        errors = [
            float(abs(Decimal(float(ours)) - theirs)) / np.spacing(abs(float(theirs)))
            for ours, theirs in zip(found, true, strict=True)
        ]
    assert max(errors) <= allowed, numbers[int(np.argmax(errors))]


def test_what_lies_beyond_the_range_has_the_limits_of_libm():
    numbers = np.array([np.nan, np.inf, -np.inf, 710.0, -709.0])
    probes.exact_exp(numbers)
    np.testing.assert_array_equal(numbers, [np.nan, np.inf, 0.0, np.inf, 0.0])
    numbers = np.array([0.0, 1.0, np.inf, -1.0, np.nan])
    probes.exact_log(numbers)
    np.testing.assert_array_equal(numbers, [-np.inf, 0.0, np.inf, np.nan, np.nan])
    numbers = np.array([0.0, -0.0, np.inf, -np.inf, 1e-300, np.nan])
    probes.exact_tanh(numbers)
    np.testing.assert_array_equal(numbers, [0.0, -0.0, 1.0, -1.0, 1e-300, np.nan])
    numbers = np.array([0.0, 1.0])
    probes.power_035(numbers)
    np.testing.assert_array_equal(numbers, [0.0, 1.0])

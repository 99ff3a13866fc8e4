from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import rfft

from audioflinger_hook.transform import TransformParameters
from tests.support.kernel_probes import probes
from tests.support.signals import SAMPLERATES, identical

pytestmark = pytest.mark.skipif(probes is None, reason="the probes need a C compiler")

CASES = 4_000
EXTENDED = np.longdouble
"""Has 11 bits more than a double on x86, and 60 more on ARM."""
RNG_SEED = 35


def uniform(low: float, high: float) -> np.ndarray:
    """Return numbers in a range, and its middle."""
    return np.append(np.random.default_rng(RNG_SEED).uniform(low, high, CASES), (low + high) / 2.0)


def spread(low: float, high: float) -> np.ndarray:
    """Return numbers of all sizes between two powers of 10, and many near 1."""
    rng = np.random.default_rng(RNG_SEED)
    sizes = 10.0 ** rng.uniform(low, high, CASES)
    return np.concatenate([sizes, rng.uniform(0.5, 2.0, CASES), 1.0 + rng.normal(0, 1e-6, CASES)])


FUNCTIONS: dict[str, tuple[Callable[..., Any], np.ndarray, float]] = {
    "exact_exp": (np.exp, np.concatenate([uniform(-700, 700), uniform(-1, 1)]), 1.0),
    "exact_log": (np.log, spread(-300, 300), 1.0),
    "exact_log2": (np.log2, spread(-300, 300), 2.0),
    "exact_log10": (np.log10, spread(-300, 300), 2.0),
    # x y is rounded before exp, which makes an error of |x y| half units.
    "exact_amplitude": (lambda x: EXTENDED(10) ** (x / 20), uniform(-120, 40), 16.0),
    "power_035": (lambda x: x ** (EXTENDED(35) / 100), spread(-6, 3), 8.0),
    "exact_tanh": (np.tanh, np.concatenate([uniform(-3, 3), uniform(-0.2, 0.2)]), 3.0),
    "exact_sin": (np.sin, uniform(-np.pi / 4, np.pi / 4), 1.0),
    "exact_cos": (np.cos, uniform(-np.pi / 4, np.pi / 4), 1.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_error_is_a_few_units_in_the_last_place(name):
    function, numbers, allowed = FUNCTIONS[name]
    found = numbers.copy()
    getattr(probes, name)(found)
    true = function(numbers.astype(EXTENDED))
    errors = np.abs(found - true) / np.spacing(np.abs(true.astype(np.float64)))
    assert errors.max() <= allowed, numbers[errors.argmax()]


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


LENGTHS = {
    *(TransformParameters().fft_length(samplerate) for samplerate in (1_000, *SAMPLERATES)),
    *(2**a * 3**b * 5**c for a in range(6) for b in range(4) for c in range(4)),
    2**13,
    3**7,
    5**5,
} - {1}


def test_every_spectrum_is_scipys():
    rng = np.random.default_rng(0)
    for length in sorted(LENGTHS):
        for frames in {length // 2, max(1, length // 2 - 1), max(1, length // 3), length}:
            samples = rng.standard_normal(frames)
            expected, bins = rfft(samples, length), np.empty((2, length // 2 + 1))
            probes.spectrum(samples, length, bins)
            error = np.abs(bins[0] + 1j * bins[1] - expected).max()
            assert error <= 1e-15 * np.log2(length) * np.abs(expected).max(), length
            # The first of them alone are the same.
            few = np.empty((2, 1 + length // 5))
            probes.spectrum(samples, length, few)
            assert identical(few, np.ascontiguousarray(bins[:, : few.shape[1]]))


@given(st.lists(st.floats(1e-300, 1e300), min_size=1, max_size=40))
@settings(max_examples=200)
def test_fifth_roots_are_exact_but_for_a_unit_in_the_last_place(numbers):
    roots = np.array(numbers)
    probes.fifth_roots(roots)
    # In extended precision: 0.2 is not a fifth, which shows from 1e30 on.
    exact = np.array(numbers, dtype=EXTENDED) ** (EXTENDED(1) / 5)
    np.testing.assert_allclose(roots, exact.astype(np.float64), rtol=4e-16)


@pytest.mark.parametrize("strange", [np.inf, -np.inf, np.nan, -1.0, 5e-324, 1e-310, 1.7e308])
def test_a_fifth_root_of_anything_else_is_a_number_or_none_and_harms_no_neighbour(strange):
    roots = np.array([1.0, 32.0, strange, 243.0, 0.0, 1_024.0])
    probes.fifth_roots(roots)
    np.testing.assert_allclose(np.delete(roots, 2), [1.0, 2.0, 3.0, 0.0, 4.0], rtol=1e-15)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
@settings(max_examples=200)
def test_cosines_of_turns_are_exact_to_the_last_bits(turns):
    cosines = np.array(turns)
    probes.cosines(cosines)
    exact = np.cos(2 * np.pi * (np.array(turns) - np.rint(turns)))
    np.testing.assert_allclose(cosines, exact, rtol=0, atol=1e-15)

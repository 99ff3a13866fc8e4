"""Units and errors that the whole project shares."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device import errors
from device.units import amplitude_to_db, db_to_amplitude, finite_or_zero


@given(st.floats(-600, 600))
def test_db_and_back_is_the_same_level(level_db):
    # 1e-12 dB: the logarithm of a double near 1 has an error of about 2e-15, times 20.
    assert amplitude_to_db(db_to_amplitude(level_db)) == pytest.approx(level_db, abs=1e-12)


def test_known_levels():
    assert amplitude_to_db(10.0) == 20.0
    assert amplitude_to_db(-0.5) == pytest.approx(-6.0206, abs=1e-4)
    assert (amplitude_to_db(0.0), db_to_amplitude(-math.inf)) == (-math.inf, 0.0)


def test_only_what_is_not_finite_becomes_zero_and_the_rest_is_not_copied():
    sound = np.array([1.0, -1e308, 5e-324])
    assert finite_or_zero(sound)[0] is sound
    broken = np.array([1.0, np.nan, np.inf, -np.inf, 2.0])
    samples, replaced = finite_or_zero(broken)
    assert (samples.tolist(), replaced) == ([1.0, 0.0, 0.0, 0.0, 2.0], 3)
    assert np.isnan(broken[1])


EXIT_CODES = {errors.UsageError: 2, errors.NotFoundError: 3, errors.LostError: 4}
EXIT_CODES |= {errors.InternalError: 5, errors.WriteError: 5}


@pytest.mark.parametrize(("kind", "exit_code"), EXIT_CODES.items())
def test_an_error_knows_its_exit_code_and_is_one_line(kind, exit_code):
    error = kind("cannot write 'a\nb': no\r\n  room")
    assert isinstance(error, errors.CushionError)
    assert (error.exit_code, str(error)) == (exit_code, "cannot write 'a b': no room")

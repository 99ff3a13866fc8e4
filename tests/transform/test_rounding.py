"""A design has the same bits where libraries round the last bits in another way."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import ellip, freqz

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core import rounding
from audioflinger_hook.core.rounding import round_filter, round_number, round_table
from audioflinger_hook.transform import filters
from audioflinger_hook.transform.design import LiveDesign, _designed
from audioflinger_hook.transform.design.synthesis import SynthesisDesign
from audioflinger_hook.transform.filters import Roots, low_pass

EPSILON = np.finfo(float).eps


def test_a_number_keeps_forty_bits_a_table_thirty_two_and_a_rounded_filter_is_the_filter():
    rng = np.random.default_rng(1)
    for number in (*rng.normal(0, 1, 100), 1e-300, 1e300, -0.018):
        rounded = round_number(number)
        assert abs(rounded - number) <= 2.0**-40 * abs(number)
        assert round_number(rounded) == rounded
    for number in (0.0, np.inf, -np.inf, 3.0, -1024.0):
        assert round_number(number) == number
    table = rng.normal(0, 1, (3, 50)) * 10.0 ** rng.uniform(-8, 8, 50)
    coarse = round_table(table)
    assert np.abs(coarse - table).max() <= 2.0**-32 * np.abs(table).max()
    np.testing.assert_array_equal(round_table(coarse), coarse)
    assert round_table(np.zeros(0)).size == 0
    # What is 0 but for rounding becomes 0.
    quarters = np.cos(np.arange(5) * np.pi / 2.0)
    np.testing.assert_array_equal(round_table(quarters), [1.0, 0.0, -1.0, 0.0, 1.0])
    zeros, poles, gain = ellip(6, 0.5, 50.0, 0.2, output="zpk")
    _, wanted = freqz(*ellip(6, 0.5, 50.0, 0.2))
    _, found = freqz(*round_filter(zeros, poles, gain))
    assert np.abs(found - wanted).max() < 1e-9


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 192_000])
def test_other_last_bits_of_a_library_give_the_same_design(samplerate, monkeypatch):
    """All cosines, sines, powers and filters of the design are off by a unit in the last place.

    But not within `filters`: a low-pass with poles close to 1 turns that into 1e-6 of its response.
    """
    designs = {name: LiveDesign.of(parameters_of(name), samplerate) for name in PROFILES}

    def off(function):
        def rounded_otherwise(*arguments, **options):
            return function(*arguments, **options) * (1.0 + EPSILON)

        return rounded_otherwise

    def filter_off(*arguments, **options):
        zeros, poles, gain = low_pass(*arguments, **options)
        return Roots(zeros, poles * (1.0 + EPSILON), gain * (1.0 + EPSILON))

    monkeypatch.setattr(filters, "np", SimpleNamespace(**vars(np)))
    for name in ("cos", "sin", "exp", "log", "interp"):
        monkeypatch.setattr(np, name, off(getattr(np, name)))
    monkeypatch.setattr("audioflinger_hook.transform.design.synthesis.low_pass", filter_off)
    for name, design in designs.items():
        again = _designed.__wrapped__(parameters_of(name), samplerate, True)
        assert again is not design
        assert again == design


def test_without_rounding_the_last_bits_would_show(monkeypatch):
    design = LiveDesign.of(parameters_of("cinema"), 48_000)
    monkeypatch.setattr(rounding, "TABLE_BITS", 60)
    monkeypatch.setattr(rounding, "TABLE_FLOOR_BITS", 60)
    again = _designed.__wrapped__(parameters_of("cinema"), 48_000, True)
    assert not np.array_equal(again.synthesis.glide, design.synthesis.glide)
    assert isinstance(again.synthesis, SynthesisDesign)

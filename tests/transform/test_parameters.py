"""The transform's parameters: ranges, messages, documentation; and the formats it accepts."""

import functools
import inspect
import math
import re
from dataclasses import FrozenInstanceError, fields
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.parameters import check_format
from device.errors import CushionError, UsageError
from tests.support.parameters import CHOICES, LIMITS
from tests.support.signals import (
    FORMS,
    identical,
    in_blocks,
    joined,
    opened,
    played,
    silence,
    tone,
    white_noise,
)

NAMES = [field.name for field in fields(TransformParameters)]
NUMBERS = [name for name in NAMES if name not in CHOICES]
SLOPES = {"dynamics": "for each phon"}
"""Numbers with a unit by another one, which their meaning names."""


def test_the_defaults_are_the_papers():
    parameters = TransformParameters()
    assert (parameters.band_low_hz, parameters.band_high_hz) == (50.0, 12_000.0)
    assert parameters.window_s == 0.04643
    assert parameters.vibration_top_hz == 220.0
    assert parameters.threshold_hz == 0.3
    assert parameters.partials_max == 16
    assert parameters.amplitude_mapping == "tonal"
    assert parameters.mapping == "paper"


def test_every_parameter_has_a_range_and_every_range_a_parameter():
    assert {*LIMITS} | {*CHOICES} == {*NAMES}
    assert list(TransformParameters.DESCRIPTIONS) == NAMES
    for name in NUMBERS:
        assert LIMITS[name].low < LIMITS[name].high
        assert LIMITS[name].low <= getattr(TransformParameters(), name) <= LIMITS[name].high


def test_every_parameter_is_documented_with_its_unit_and_meaning():
    documentation = inspect.getdoc(TransformParameters) or ""
    for name in NAMES:
        assert name in documentation
        assert (LIMITS.get(name) or CHOICES[name]).meaning
        if name in SLOPES:
            assert LIMITS[name].unit
            assert SLOPES[name] in LIMITS[name].meaning
        elif name in LIMITS and LIMITS[name].unit:
            # The unit stands in the name, too, where a reader of a call sees it.
            assert name.endswith("_" + LIMITS[name].unit.lower())


@pytest.mark.parametrize("name", NUMBERS)
def test_both_ends_of_a_range_are_allowed(name):
    # The partners are moved where the end of a range would contradict a default.
    partners: dict[tuple[str, str], dict[str, Any]] = {
        ("band_high_hz", "low"): {"band_low_hz": 50.0},
        ("vibration_top_hz", "low"): {"window_s": 0.05},
        ("window_s", "low"): {"vibration_top_hz": 400.0},
    }
    for end in ("low", "high"):
        value = getattr(LIMITS[name], end)
        value = int(value) if name == "partials_max" else value
        TransformParameters(**(partners.get((name, end), {}) | {name: value}))


@pytest.mark.parametrize("name", CHOICES)
def test_a_choice_is_one_of_its_words_and_its_default_is_the_first(name):
    assert getattr(TransformParameters(), name) == CHOICES[name].words[0]
    for word in CHOICES[name].words:
        chosen: dict[str, Any] = {name: word}
        assert getattr(TransformParameters(**chosen), name) == word
    wrongs: list[Any] = ["loud", "", str(CHOICES[name].words[0]).upper(), 1, ["paper"]]
    for wrong in wrongs:
        with pytest.raises(UsageError, match="is not known; allowed: ") as refusal:
            TransformParameters(**dict[str, Any]({name: wrong}))
        assert str(refusal.value).startswith(f"{name}={wrong!r} ")
        assert f"allowed: {', '.join(map(str, CHOICES[name].words))}" in str(refusal.value)


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("end", ["low", "high"])
def test_a_value_out_of_range_is_refused_by_name_value_and_limits(name, end):
    limits = LIMITS[name]
    outside = limits.low - 1 if end == "low" else limits.high + 1
    if name != "partials_max":
        bound = limits.low if end == "low" else limits.high
        outside = math.nextafter(bound, -math.inf if end == "low" else math.inf)
    values: dict[str, Any] = {name: outside}
    with pytest.raises(UsageError) as refusal:
        TransformParameters(**values)
    message = str(refusal.value)
    assert f"{name}={outside:.12g}" in message
    assert f"{limits.low:g} to {limits.high:g} {limits.unit}".rstrip() in message


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, "50", None, True, [50.0], 50 + 0j, b"50"]
)
def test_what_is_no_finite_number_is_refused(name, value):
    with pytest.raises(UsageError, match=f"^{name}=.*allowed: "):
        TransformParameters(**{name: value})


@pytest.mark.parametrize("value", [16.0, 1.5, "16"])
def test_a_count_must_be_a_whole_number(value):
    with pytest.raises(UsageError, match=r"partials_max=.*is not a whole number; allowed: 1 to 64"):
        TransformParameters(partials_max=value)


@pytest.mark.parametrize("name", [name for name in NUMBERS if name != "partials_max"])
def test_a_whole_number_will_do_where_a_number_is_asked(name):
    value = {"window_s": 1, "threshold_hz": 1}.get(name, 300)
    if LIMITS[name].low <= value <= LIMITS[name].high:
        values: dict[str, Any] = {name: value}
        assert getattr(TransformParameters(**values), name) == value


def test_the_band_must_span_an_octave():
    with pytest.raises(UsageError, match=r"band_high_hz=500 is under twice band_low_hz=300.*600"):
        TransformParameters(band_low_hz=300.0, band_high_hz=500.0)
    TransformParameters(band_low_hz=300.0, band_high_hz=600.0)


def test_vibration_must_have_an_octave_above_one_cycle_a_window():
    with pytest.raises(UsageError, match=r"vibration_top_hz=100 .*1/window_s=100\.0 Hz.*200\.0"):
        TransformParameters(window_s=0.01, vibration_top_hz=100.0)
    TransformParameters(window_s=0.01, vibration_top_hz=200.0)


def test_all_mistakes_are_named_at_once_in_one_line():
    mistakes: dict[str, Any] = {
        "window_s": 0.5,
        "band_low_hz": 5.0,
        "band_high_hz": "high",
        "vibration_top_hz": 1_000.0,
        "threshold_hz": -1.0,
        "partials_max": 0,
    }
    with pytest.raises(UsageError) as refusal:
        TransformParameters(**mistakes)
    message = str(refusal.value)
    assert "\n" not in message
    for name in mistakes:
        assert f"{name}=" in message
    assert message.count("allowed: ") == len(mistakes)


def test_refusals_names_what_is_wrong_without_raising():
    assert TransformParameters.refusals({}) == {}
    assert TransformParameters.refusals({"window_s": 0.02, "vibration_top_hz": 300.0}) == {}
    found = TransformParameters.refusals({"window_s": 5, "partials_max": 1.5})
    assert list(found) == ["window_s", "partials_max"]


def test_an_unknown_keyword_is_refused():
    for thing, keyword in (
        (TransformParameters, "window_ms"),
        (TransformParameters, "threshold"),
        (functools.partial(HapticTransform, 48_000), "sample_rate"),
        (functools.partial(HapticTransform, 48_000), "parameter"),
    ):
        unknown: dict[str, Any] = {keyword: 1}
        with pytest.raises(TypeError, match=f"unexpected keyword argument '{keyword}'"):
            thing(**unknown)


def test_parameters_do_not_change_once_made():
    with pytest.raises(FrozenInstanceError):
        TransformParameters().window_s = 0.1  # type: ignore[misc]


@given(
    window_s=st.floats(0.01, 0.2),
    low=st.floats(20, 1_000),
    high=st.floats(200, 20_000),
    top=st.floats(60, 400),
)
def test_what_follows_from_the_parameters_keeps_its_equations(window_s, low, high, top):
    assume(high >= 2 * low)
    assume(top >= 2 / window_s)
    parameters = TransformParameters(window_s, low, high, top)
    assert parameters.vibration_bottom_hz == 1 / window_s
    at_top = parameters.scale_hz * math.log(high / low) + parameters.vibration_bottom_hz
    assert at_top == pytest.approx(top, rel=1e-12)
    geometric = parameters.vibration_bottom_hz * (high / low) ** parameters.scale_ratio
    assert geometric == pytest.approx(top, rel=1e-12)
    for samplerate in (1_000, 44_100, 768_000):
        frames = parameters.window_frames(samplerate)
        assert abs(frames - window_s * samplerate) <= 0.5
        assert 2 * frames <= parameters.fft_length(samplerate) <= 2.3 * frames
        assert parameters.unit_strength_hz(samplerate) == 1.30 * samplerate / frames


@pytest.mark.exhaustive
@pytest.mark.parametrize("form", FORMS)
@given(
    window_s=st.floats(0.01, 0.2),
    low=st.floats(20, 1_000),
    high=st.floats(200, 20_000),
    top=st.floats(60, 400),
    threshold=st.sampled_from([0.001, 0.3, 10.0, 1_000.0]),
    partials=st.sampled_from([1, 2, 16, 64]),
    samplerate=st.sampled_from([1_000, 1_001, 1_600, 2_000, 4_000, 8_000, 11_025, 48_000, 96_000]),
)
# A band that ends far below where the images of low tones are cleared.
@example(
    window_s=0.01, low=90.0, high=200.0, top=323.0, threshold=0.3, partials=1, samplerate=8_000
)
# A spectrum whose half has an odd length, with bins to its end in the images' reach.
@example(
    window_s=0.0295, low=140.0, high=9_000.0, top=74.0, threshold=0.3, partials=64,
    samplerate=1_500,
)  # fmt: skip
# The band's lowest frequency lies above the samplerate's half.
@example(
    window_s=0.05, low=600.0, high=12_000.0, top=220.0, threshold=0.3, partials=16,
    samplerate=1_000,
)  # fmt: skip
@settings(max_examples=60)
def test_all_that_is_allowed_works_or_is_refused_as_wrong_usage(
    form, window_s, low, high, top, threshold, partials, samplerate
):
    assume(high >= 2 * low)
    assume(top >= 2 / window_s)
    parameters = TransformParameters(window_s, low, high, top, threshold, partials)
    sound = joined(
        white_noise(0.25, samplerate),
        tone(min(low * 1.1, samplerate / 3), 0.3, samplerate),
        silence(0.3, samplerate),
    )
    try:
        opened(samplerate, 1, form, parameters=parameters)
    except UsageError as refusal:
        # The one combination that cannot work: the band begins above half the samplerate.
        assert low >= 0.45 * samplerate
        assert "band_low_hz" in str(refusal)  # noqa: PT017
        return
    vibration = played(sound, samplerate, form=form, parameters=parameters)
    assert np.isfinite(vibration).all()
    if form != "reference":
        assert np.abs(vibration).max(initial=0.0) < 1.0
    blocks = [997] * (sound.size // 997)
    cut = in_blocks(sound, blocks, samplerate, form=form, parameters=parameters)
    assert identical(cut, vibration)


@pytest.mark.parametrize("samplerate", [1_000, 8_000, 44_100, 192_000, 768_000])
@pytest.mark.parametrize("channels", [1, 2, 64])
def test_every_supported_format_is_accepted(samplerate, channels):
    check_format(samplerate, channels)


@pytest.mark.parametrize("samplerate", [-1, 0, 100, 999, 768_001, 10**9])
def test_an_unsupported_samplerate_is_refused_with_the_limits_and_the_way_out(samplerate):
    expected = rf"samplerate={samplerate} Hz .*1000 to 768000 Hz; resample"
    with pytest.raises(UsageError, match=expected):
        check_format(samplerate, 2)
    with pytest.raises(UsageError, match=expected):
        HapticTransform(samplerate)


@pytest.mark.parametrize("channels", [-1, 0, 65, 1_000])
def test_an_unsupported_channel_count_is_refused_with_the_limits_and_the_way_out(channels):
    with pytest.raises(UsageError, match=rf"channels={channels} .*1 to 64; mix"):
        check_format(48_000, channels)


def test_a_wrong_rate_and_a_wrong_channel_count_are_named_together():
    with pytest.raises(UsageError, match=r"samplerate=8 .*channels=65 "):
        HapticTransform(8, 65)


def test_an_unknown_form_is_refused_with_the_known_ones():
    with pytest.raises(UsageError, match=r"'alive'.*live, reference"):
        HapticTransform(48_000, form="alive")  # type: ignore[arg-type]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("shape", [(10,), (10, 1), (10, 3), (2, 10, 2), ()])
def test_a_block_of_another_shape_is_refused_with_both_shapes(form, shape):
    transform = opened(48_000, 2, form)
    with pytest.raises(UsageError, match=re.escape("allowed: (frames, 2)")):
        transform.process(np.zeros(shape))


@pytest.mark.parametrize("form", FORMS)
def test_one_channel_may_come_with_or_without_its_axis(form):
    sound = tone(300, 0.2, 48_000)
    assert identical(played(sound, 48_000, form=form), played(sound[:, None], 48_000, form=form))


def test_errors_of_the_transform_are_wrong_usage_and_end_a_command_with_2():
    assert issubclass(UsageError, CushionError)
    with pytest.raises(UsageError) as refusal:
        TransformParameters(window_s=1.0)
    assert refusal.value.exit_code == 2


def test_the_public_names_say_what_the_caller_gets():
    for thing in (HapticTransform, TransformParameters, check_format):
        assert inspect.getdoc(thing)
    for name, member in inspect.getmembers(HapticTransform):
        if not name.startswith("_"):
            assert inspect.getdoc(member), name
    documentation = inspect.getdoc(HapticTransform) or ""
    for name in inspect.signature(HapticTransform).parameters:
        assert f"\n{name} :" in documentation, name

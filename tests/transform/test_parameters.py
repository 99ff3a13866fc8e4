import inspect
import itertools
import math
from dataclasses import FrozenInstanceError, fields
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError
from tests.support import signals
from tests.support.data import table
from tests.support.parameters import CHOICES, LIMITS

NAMES = [field.name for field in fields(TransformParameters)]
NUMBERS = [*LIMITS]
SLOPES = {"dynamics": "for each phon"}
"""Numbers with a unit by another one, which their meaning names."""


def test_every_parameter_has_a_range_and_is_documented_with_its_unit_and_meaning():
    documentation = inspect.getdoc(TransformParameters) or ""
    for name in NAMES:
        assert name in documentation
        assert TransformParameters.DESCRIPTIONS[name].meaning
        if name in SLOPES:
            assert LIMITS[name].unit
            assert SLOPES[name] in LIMITS[name].meaning
        elif name in LIMITS and LIMITS[name].unit:
            # The unit stands in the name, too, where a reader of a call sees it.
            assert name.endswith("_" + LIMITS[name].unit.lower())
    assert {*LIMITS, *CHOICES, "fit"} == {*NAMES}
    assert list(TransformParameters.DESCRIPTIONS) == NAMES
    for name in NUMBERS:
        assert LIMITS[name].low < LIMITS[name].high
        assert LIMITS[name].low <= getattr(TransformParameters(), name) <= LIMITS[name].high


PARTNERS: dict[tuple[str, str], dict[str, Any]] = {
    ("band_high_hz", "low"): {"band_low_hz": 50.0},
    ("vibration_top_hz", "low"): {"window_s": 0.05},
    ("window_s", "low"): {"vibration_top_hz": 400.0},
}
"""What is moved where the end of a range would contradict a default."""


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("end", ["low", "high"])
def test_what_is_beyond_the_end_of_a_range_is_refused_by_name_value_and_limits(name, end):
    limits, beyond = LIMITS[name], -math.inf if end == "low" else math.inf
    last = getattr(limits, end)
    outside = math.nextafter(last, beyond)
    if name == "partials_max":
        last = int(last)
        outside = last + int(math.copysign(1, beyond))
    TransformParameters(**(PARTNERS.get((name, end), {}) | {name: last}))
    values: dict[str, Any] = {name: outside}
    with pytest.raises(UsageError) as refusal:
        TransformParameters(**values)
    assert f"{name}={outside:.12g}" in str(refusal.value)
    assert f"{limits.low:g} to {limits.high:g} {limits.unit}".rstrip() in str(refusal.value)


@pytest.mark.parametrize("name", CHOICES)
def test_a_choice_is_one_of_its_words_and_its_default_is_the_first(name):
    assert getattr(TransformParameters(), name) == CHOICES[name].words[0]
    for word in CHOICES[name].words:
        chosen: dict[str, Any] = {"fit": "70:0", name: word}
        assert getattr(TransformParameters(**chosen), name) == word
    wrongs: list[Any] = ["loud", "", str(CHOICES[name].words[0]).upper(), 1, ["paper"]]
    for wrong in wrongs:
        with pytest.raises(UsageError, match="is not known; allowed: ") as refusal:
            TransformParameters(**dict[str, Any]({name: wrong}))
        assert str(refusal.value).startswith(f"{name}={wrong!r} ")
        assert f"allowed: {', '.join(map(str, CHOICES[name].words))}" in str(refusal.value)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, "50", None, True, [50.0], 50 + 0j, b"50"]
)
def test_what_is_no_finite_number_is_refused(name, value):
    with pytest.raises(UsageError, match=f"^{name}=.*allowed: "):
        TransformParameters(**{name: value})


def test_an_unknown_form_and_too_narrow_a_band_are_refused():
    with pytest.raises(UsageError, match=r"'alive'.*live, reference"):
        HapticTransform(48_000, form="alive")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"vibration_top_hz=100 .*1/window_s=100\.0 Hz.*200\.0"):
        TransformParameters(window_s=0.01, vibration_top_hz=100.0)
    TransformParameters(window_s=0.01, vibration_top_hz=200.0)


def test_refusals_names_what_is_wrong_without_raising_and_parameters_do_not_change():
    assert TransformParameters.refusals({}) == {}
    assert TransformParameters.refusals({"window_s": 0.02, "vibration_top_hz": 300.0}) == {}
    found = TransformParameters.refusals({"window_s": 5, "partials_max": 1.5})
    assert list(found) == ["window_s", "partials_max"]
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
@pytest.mark.parametrize("form", signals.FORMS)
@given(
    st.floats(0.01, 0.2),
    st.floats(20, 1_000),
    st.floats(200, 20_000),
    st.floats(60, 400),
    st.sampled_from([0.001, 0.3, 10.0, 1_000.0]),
    st.sampled_from([1, 2, 16, 64]),
    st.sampled_from([1_000, 1_001, 1_600, 2_000, 4_000, 8_000, 11_025, 48_000, 96_000]),
)
# A band that ends far below where the images of low tones are cleared.
@example(0.01, 90.0, 200.0, 323.0, 0.3, 1, 8_000)
# A spectrum whose half has an odd length, with bins to its end in the images' reach.
@example(0.0295, 140.0, 9_000.0, 74.0, 0.3, 64, 1_500)
# The band's lowest frequency lies above the samplerate's half.
@example(0.05, 600.0, 12_000.0, 220.0, 0.3, 16, 1_000)
@settings(max_examples=60)
def test_all_that_is_allowed_works_or_is_refused_as_wrong_usage(
    form, window_s, low, high, top, threshold, partials, samplerate
):
    assume(high >= 2 * low)
    assume(top >= 2 / window_s)
    parameters = TransformParameters(window_s, low, high, top, threshold, partials)
    steady = signals.tone(min(low * 1.1, samplerate / 3), 0.3, samplerate)
    noise, pause = signals.white_noise(0.25, samplerate), signals.silence(0.3, samplerate)
    sound = signals.joined(noise, steady, pause)
    try:
        signals.opened(samplerate, 1, form, parameters=parameters)
    except UsageError as refusal:
        # The one combination that cannot work: the band begins above half the samplerate.
        assert low >= 0.45 * samplerate
        assert "band_low_hz" in str(refusal)  # noqa: PT017
        return
    vibration = signals.played(sound, samplerate, form=form, parameters=parameters)
    assert np.isfinite(vibration).all()
    if form != "reference":
        assert np.abs(vibration).max(initial=0.0) < 1.0
    blocks = [997] * (sound.size // 997)
    cut = signals.in_blocks(sound, blocks, samplerate, form=form, parameters=parameters)
    assert signals.identical(cut, vibration)


@pytest.mark.parametrize(
    ("samplerate", "channels", "refusal"),
    table("unsupported-formats.toml")["refused"],
)
def test_an_unsupported_format_is_refused_with_limits_and_a_way_out(samplerate, channels, refusal):
    for check in (check_format, HapticTransform):
        with pytest.raises(UsageError, match=refusal):
            check(samplerate, channels)
    for supported in itertools.product((1_000, 768_000), (1, 64)):
        check_format(*supported)


@pytest.mark.parametrize("form", signals.FORMS)
def test_one_channel_may_come_with_or_without_its_axis(form):
    sound = signals.tone(300, 0.2, 48_000)
    assert signals.identical(
        signals.played(sound, 48_000, form=form), signals.played(sound[:, None], 48_000, form=form)
    )

"""The values that are allowed beside the other settings."""

from dataclasses import replace
from typing import Any

import pytest

from audioflinger_hook.config.allowed_now import allowed_now
from audioflinger_hook.config.edits import EDITABLE
from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.values import Number

NARROW = TransformParameters(band_low_hz=200.0, band_high_hz=500.0, window_s=0.02)
OWNERS = [
    *(Settings(profile=name) for name in PROFILES),
    *(Settings(profile=name).parameters for name in PROFILES),
    *(LiveSettings(), LiveSettings(drop_in=True, offset_ms=-20.0), NARROW),
]


@pytest.mark.parametrize("owner", OWNERS, ids=lambda owner: type(owner).__name__)
def test_all_that_is_offered_is_accepted_and_what_is_just_outside_is_not(owner: Any) -> None:
    for key in EDITABLE.values():
        if not issubclass(type(owner), key.owner) or not isinstance(key.description, Number):
            continue
        narrowed = allowed_now(owner, key.field)
        schema = {**key.description.json_schema(), **narrowed}
        for end, beyond in (("minimum", -1e-3), ("maximum", 1e-3)):
            if schema["type"] == "number":
                replace(owner, **{key.field: schema[end]})
            if end in narrowed:
                with pytest.raises(UsageError):
                    replace(owner, **{key.field: schema[end] + beyond})


def test_limits_follow_the_other_values():
    assert allowed_now(LiveSettings(), "offset_ms") == {"minimum": 0.0}
    assert allowed_now(LiveSettings(drop_in=True), "offset_ms") == {}
    assert allowed_now(NARROW, "band_low_hz")["maximum"] == pytest.approx(250.0)
    assert allowed_now(NARROW, "band_high_hz")["minimum"] == pytest.approx(400.0)
    assert allowed_now(NARROW, "vibration_top_hz")["minimum"] == pytest.approx(100.0)


def test_a_word_that_contradicts_is_not_offered():
    actuators = (ActuatorSettings(channels=("FL",)),)
    assert allowed_now(Settings(actuators=actuators), "channels") == {"enum": ["mono"]}
    assert allowed_now(Settings(), "channels") == {}

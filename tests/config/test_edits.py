import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.config import file as config
from audioflinger_hook.config.edits import EDITABLE, RULE, LiveEdits, editable, edited_text
from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.config.schema import allowed_now
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.errors import UsageError, WriteError
from device.values import Number
from tests.support.data import text

TEXT = text("edited.toml")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "cushion" / "config.toml"
    path.parent.mkdir()
    path.write_text(TEXT)
    return path


def test_comments_and_order_stay_and_new_keys_are_added_where_they_belong() -> None:
    changed = edited_text(TEXT, {"gain_db": -6.0, "transform.threshold_hz": 9.0})
    assert changed == TEXT.replace("-3.0", "-6.0").replace("8.0", "9.0")
    changed = edited_text(TEXT, {"offset_ms": 5.0, "applications.exclude": ["Chat"]})
    document = tomllib.loads(changed)
    assert (document["offset_ms"], document["applications"]) == (5.0, {"exclude": ["Chat"]})
    assert [line for line in TEXT.splitlines() if line not in changed.splitlines()] == []


RULES = text("edited-rules.toml")
FIREFOX = RULE + "Firefox"
TABLE = '\n[[application]]\nmatch = "Firefox"\nprofile = "music"\n'


@pytest.mark.parametrize(
    ("edits", "before", "after"),
    [
        ({FIREFOX: {"profile": "music"}}, "# early\n", f"# early\n{TABLE}"),
        ({RULE + "SUPER*": {"profile": "music"}}, '"game"', '"music"'),
        (
            {RULE + " super* ": {"profile": "game", "gain_db": -3.0}},
            "# early\n",
            "# early\ngain_db = -3.0\n",
        ),
        ({RULE + "super*": {"feel": False}}, 'profile = "game" # early', "feel = false"),
        (
            {RULE + "super*": None},
            '\n[[application]] # by its name\nmatch = "super*" # all versions\n'
            'profile = "game" # early\n',
            "\n",
        ),
        ({FIREFOX: None}, "", ""),
    ],
)
def test_rules_are_added_changed_and_removed_and_every_comment_stays(edits, before, after):
    assert edited_text(RULES, edits) == (RULES.replace(before, after) if before else RULES)


@pytest.mark.parametrize("text", ["", "gain_db = -3.0\n", TEXT, RULES])
def test_a_rule_that_is_added_and_removed_leaves_the_file_as_it_was(text):
    added = edited_text(text, {FIREFOX: {"profile": "music"}})
    assert TABLE.lstrip() in added
    assert edited_text(added, {FIREFOX: None}) == text


def test_rules_in_one_array_are_changed_there():
    text = 'application = [{match = "a", feel = false}] # mine\ngain_db = -3.0\n'
    added = edited_text(text, {FIREFOX: {"feel": False}})
    rules = [{"match": "a", "feel": False}, {"match": "Firefox", "feel": False}]
    assert tomllib.loads(added) == {"application": rules, "gain_db": -3.0}
    assert "# mine" in added
    changed = edited_text(added, {RULE + "a": {"profile": "game"}, FIREFOX: None})
    assert tomllib.loads(changed)["application"] == [{"match": "a", "profile": "game"}]


@pytest.mark.parametrize("match", ["Firefox", "a.b", "a]", "application:Radio: live", '"\\'])
def test_any_name_of_an_application_becomes_a_rule(match):
    text = edited_text(TEXT, {RULE + match: {"feel": False}})
    assert tomllib.loads(text)["application"] == [{"match": match, "feel": False}]


def test_a_removed_key_takes_its_default_again(path: Path) -> None:
    edits = LiveEdits(path)
    edits.accept({"gain_db": None})
    edits.save()
    assert config.load(path).settings.gain_db == 0.0
    assert "# My cushion." in path.read_text()


VALUES: dict[str, st.SearchStrategy[Any]] = {
    "gain_db": st.one_of(st.none(), st.floats(-60.0, 0.0)),
    "offset_ms": st.one_of(st.none(), st.floats(0.0, 1000.0)),
    "profile": st.sampled_from(["paper", "cinema", "game", None]),
    "applications.exclude": st.lists(st.text(min_size=1).filter(str.strip), max_size=3),
    "transform.threshold_hz": st.one_of(st.none(), st.floats(4.0, 12.0)),
    FIREFOX: st.sampled_from([None, {"feel": False}, {"profile": "game"}, {"feel": True}]),
    RULE + "mpv": st.sampled_from([None, {"profile": "music", "gain_db": -3.0}]),
}
CHANGES = st.sampled_from(sorted(VALUES)).flatmap(
    lambda name: VALUES[name].map(lambda value: {name: value})
)


@given(st.lists(st.one_of(CHANGES, st.sampled_from(["undo", "save"])), max_size=12))
def test_the_saved_file_says_what_applied_and_undo_goes_back_step_by_step(
    tmp_path_factory: pytest.TempPathFactory, steps: list[Any]
) -> None:
    path = tmp_path_factory.mktemp("edits") / "config.toml"
    path.write_text(TEXT)
    edits = LiveEdits(path)
    past = [config.load(path, edits=edits.values)]
    for step in steps:
        if step == "save":
            edits.save()
            assert not edits.unsaved()
            assert config.load(path) == past[-1]
        elif step == "undo" and len(past) > 1:
            edits.undo()
            past.pop()
        elif isinstance(step, dict):
            edits.accept(step)
            past.append(config.load(path, edits=edits.values))
        assert config.load(path, edits=edits.values) == past[-1]
        assert edits.undo_count == len(past) - 1


def test_an_undone_change_leaves_the_options_of_the_command_line_in_force(path: Path) -> None:
    edits = LiveEdits(path)
    edits.accept({"offset_ms": 5.0})
    assert edits.values == {"offset_ms": 5.0}
    edits.undo()
    assert edits.values == {}
    with pytest.raises(UsageError, match="nothing to undo"):
        edits.undo()


def test_every_key_can_be_changed_but_those_that_name_a_file_or_a_device() -> None:
    for name in ("device", "tap", "rig", "effects_file", "actuator.gain_db", "x"):
        with pytest.raises(UsageError, match="cannot be changed"):
            editable(name)
    assert {"gain_db", "profile", "offset_ms", "engine", "applications.exclude"} <= EDITABLE.keys()
    assert editable("transform.partials_max").name == "partials_max"


def test_a_file_that_is_missing_is_made_when_the_edits_are_saved(tmp_path: Path) -> None:
    path = tmp_path / "new" / "config.toml"
    edits = LiveEdits(path)
    edits.accept({"gain_db": -6.0})
    assert config.load(path, edits=edits.values).settings.gain_db == -6.0
    assert not path.exists()
    edits.save()
    assert path.read_text() == "gain_db = -6.0\n"


def test_a_file_that_cannot_be_written_or_has_a_mistake_stays_and_the_edits_are_kept(
    path: Path,
) -> None:
    path.write_text("gain_db = \n")
    for place, words in ((path.parent, "cannot be read"), (path, "not TOML")):
        edits = LiveEdits(place)
        edits.accept({"gain_db": -6.0})
        with pytest.raises((UsageError, WriteError), match=words):
            edits.save()
        assert edits.unsaved().keys() == {"gain_db"}
    assert path.read_text() == "gain_db = \n"


def test_an_undone_change_leaves_nothing_unsaved_after_an_earlier_save(path: Path) -> None:
    edits = LiveEdits(path)
    edits.accept({"gain_db": -9.0})
    edits.save()
    edits.accept({"gain_db": -12.0})
    assert edits.unsaved().keys() == {"gain_db"}
    edits.undo()
    assert edits.unsaved() == {}
    edits.undo()  # what the file held first, which it does not hold any more
    assert edits.unsaved().keys() == {"gain_db"}


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

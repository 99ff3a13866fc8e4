import json
import re
import tomllib
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import fastjsonschema
import pytest

from audioflinger_hook.config import file as config
from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.config.profiles import LIVE_DEFAULT, OFFLINE_DEFAULT
from audioflinger_hook.config.schema import CHANGES, HEADERS, KEYS, REPLACED, json_schema, keys_of
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.recording import settings_from
from audioflinger_hook.daemon.run_config import RunConfig, changes_between
from audioflinger_hook.effect.haptic_parameters import HAPTIC_PARAMETERS
from audioflinger_hook.sources import parse_tap
from audioflinger_hook.transform import TransformParameters
from device.address import parse_device
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.values import Choice, Described, Number, Switch
from tests.support.commands import call, refused
from tests.support.data import table, text

ROOT = Path(__file__).resolve().parents[2]
CONFIG_PAGE = ROOT / "docs/config.md"
EXAMPLES = [
    text
    for page in (CONFIG_PAGE, *sorted({*ROOT.glob("docs/**/*.md")} - {CONFIG_PAGE}))
    for text in re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL)
]

MISTAKES = text("mistakes.toml")

EXPECTED = table("mistakes-expected.toml")["expected"]


def test_mistakes_of_every_kind_are_named_at_once(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(MISTAKES)
    found, mistakes = config.check(path)
    done, documents = (call("check", "--config", path, *option) for option in ((), ("--json",)))
    lines = done.stderr.splitlines()
    assert (found, done.code, documents.code) == (None, 2, 2)
    assert json.loads(documents.stdout) == [*map(asdict, mistakes)]
    assert len(mistakes) == len(lines) == len(EXPECTED)
    for mistake, message, expected in zip(mistakes, lines, EXPECTED, strict=True):
        line, key, value, problem, allowed, nearest = expected
        assert (mistake.line, mistake.key, mistake.value) == (line, key, value)
        assert mistake.problem.startswith(problem)
        assert mistake.allowed.startswith(allowed)
        assert mistake.nearest == nearest
        assert message.startswith(f"cushion: error: {path}: line {line}: {key}")
        assert message.isprintable()
        for part in (value, problem, f"; allowed: {allowed}"):
            assert part in message
        assert message.endswith(f"; did you mean {nearest}?") == bool(nearest)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (
            TransformParameters,
            {"window_s": 9, "mapping": "jnx", "partials_max": 0.5, "band_high_hz": "high"}
            | {"band_low_hz": 5.0, "vibration_top_hz": 1_000.0, "threshold_hz": -1.0},
        ),
        (Settings, {"profile": "loud", "gain_db": 3, "rig": "none", "damping": True}),
        (LiveSettings, {"tap": ("a", "b"), "device": "usb:x", "realtime": 1, "offset_ms": 1e9}),
        (ActuatorSettings, {"channels": (), "polarity": "up", "delay_ms": -1.0}),
    ],
)
def test_a_constructor_names_every_refused_value(kind: type[Any], wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError) as error:
        kind(**wrong)
    for name in wrong:
        assert re.search(rf"(^|; ){name}=", str(error.value))
    assert str(error.value).count("allowed: ") == len(wrong)
    assert "\n" not in str(error.value)


def test_settings_name_the_mistakes_of_several_actuators_together() -> None:
    actuators = (ActuatorSettings((0,), rig="none"), ActuatorSettings((0,)))
    with pytest.raises(UsageError) as error:
        Settings(gain_db=1.0, channels="each", actuators=actuators)
    for part in ("gain_db=1 ", "channels='each'", "actuator[1].rig = 'none' is", "[2] wants"):
        assert part in str(error.value)


def test_a_key_that_was_replaced_is_refused_with_the_one_that_replaces_it(tmp_path: Path) -> None:
    for section, replaced in REPLACED.items():
        for old, new in replaced.items():
            path = tmp_path / "config.toml"
            path.write_text(f"[{section}]\n{old} = 20\n")
            said = refused(call("check", "--config", path))
            assert f"line 2: {section}.{old} = 20" in said
            assert f"is no longer a key; allowed: {new}" in said
    facts: dict[str, str | int | float | bool] = {"form": "live", "follower_db": 12.0}
    with pytest.raises(UsageError, match=r"follower_db is now loudness_db.*give others with"):
        settings_from(facts)  # of a capture


def accepts(document: object, schema: dict[str, Any] | None = None) -> bool:
    try:
        fastjsonschema.validate(schema or json_schema(), document)
    except fastjsonschema.JsonSchemaValueException:
        return False
    return True


def test_check_prints_the_schema_and_needs_no_config(tmp_path: Path) -> None:
    done = call("check", "--schema", "--config", tmp_path / "none.toml")
    assert (done.code, done.stderr) == (0, "")
    printed = json.loads(done.stdout)
    assert printed == json_schema()
    assert printed["$schema"] == "https://json-schema.org/draft/2020-12/schema"


def test_the_schema_accepts_the_examples_of_the_pages_and_every_default() -> None:
    examples = [tomllib.loads(text) for text in EXAMPLES]
    others = {"project", "conditions"}  # packages, and designs of studies
    configs = [example for example in examples if not others & example.keys()]
    assert len(configs) == 7
    # All keys of the example, those in comments included.
    document = tomllib.loads(re.sub(r"^# (\w+ = )", r"\1", EXAMPLES[0], flags=re.MULTILINE))
    assert document.keys() >= keys_of("").keys()
    assert all(map(accepts, (*configs, document, {})))
    for key in KEYS:
        default = key.json_schema().get("default")
        assert default is None or accepts(default, key.json_schema())


def test_the_schema_refuses_what_the_check_refuses_of_single_keys() -> None:
    document = tomllib.loads(MISTAKES.replace('polarity == "normal"\n', ""))
    tables = {"": document, "transform": document["transform"]}
    tables |= {f"actuator[{n}]": one for n, one in enumerate(document["actuator"], 1)}
    for _, key, _, problem, _, _ in EXPECTED:
        section, _, name = key.rpartition(".")
        if problem == "is not TOML" or name == "band_high_hz":
            continue  # contradictions are for the check alone
        one = {name: tables[section][name]} if name in tables[section] else {}
        if section.startswith("actuator"):
            one = {"actuator": [one if name == "channels" else one | {"channels": [0]}]}
        elif section:
            one = {section: one}
        assert not accepts(one), key


@pytest.mark.parametrize("key", KEYS, ids=lambda key: f"{key.section}.{key.name}")
def test_check_and_schema_agree_on_the_edges_of_every_key(key: Any) -> None:
    described = key.description
    values: list[object] = [True, "", "no such thing: x", 1.5, [], ["a"], {}]
    if isinstance(described, Number):
        values += [described.low, described.high, described.low - 1, described.high + 1]
    if isinstance(described, Choice):
        values += [*described.words]
    for value in values:
        in_schema = accepts(value, key.json_schema())
        refused = described.refuse(value) is not None
        # The schema knows no files and no grammar of addresses; else they are the same.
        if isinstance(described, (Number, Choice)) or not in_schema:
            assert in_schema != refused, value


def test_every_setting_is_a_key_and_every_key_is_a_setting() -> None:
    not_keys = {"parameters", "said", "actuators", "application_rules"}
    for owner in (Settings, LiveSettings, TransformParameters, ActuatorSettings, ApplicationRule):
        held = {key.field for key in KEYS if key.owner is owner}
        assert held == {field.name for field in fields(owner)} - not_keys
    for key in KEYS:
        assert key.change in CHANGES
        assert key.description.meaning
        assert key.name == key.flag.removeprefix("--").replace("-", "_") or not key.flag
    for section, renamed in REPLACED.items():
        assert {new.partition(",")[0] for new in renamed.values()} <= keys_of(section).keys()
        assert not renamed.keys() & keys_of(section).keys()


def test_the_effect_has_the_ranges_of_the_schema() -> None:
    parameters = {parameter.name: parameter for parameter in HAPTIC_PARAMETERS}
    for key in (*keys_of("transform").values(), keys_of("")["gain_db"]):
        if key.field in ("channels", "fit"):
            continue  # the effect's are called per_channel, and any text
        parameter = parameters[key.field]
        assert parameter.default == key.default
        if isinstance(key.description, Number):
            assert (parameter.low, parameter.high) == (key.description.low, key.description.high)
            assert parameter.unit == key.description.unit
        else:
            assert isinstance(key.description, Choice)
            assert parameter.choices == key.description.words


KINDS = {
    "nothing": ("level", "actuators", "volume", "offset", "left_out"),
    "next stream": ("priority",),
    "stream": ("tap", "device", "drop_in"),
    "streams": ("blocks",),
    "transform": ("transform",),
    "engine": ("engine",),
    "another engine": ("way",),
}
"""By the schema's words, what `Change` calls a change."""


def another(key: Any) -> Any:
    described = key.description
    if isinstance(described, Switch):
        return not key.default
    if isinstance(described, Number):
        return described.high if key.default != described.high else described.low
    if isinstance(described, Choice):
        return described.words[-1] if key.default != described.words[-1] else described.words[0]
    by_name = {
        "rig": "consumer",
        "tap": ("sink:a",),
        "device": "sink:b",
        "channels": (9,),
        "match": "a",
        "fit": "25:0,70:1",
    }
    return (by_name | {"effects_file": Path("x.xml")}).get(key.field, ("a",))


@pytest.mark.parametrize("key", KEYS, ids=lambda key: f"{key.section}.{key.name}")
def test_a_key_of_a_file_becomes_the_setting_of_its_field(key: Any, tmp_path: Path) -> None:
    value, path = another(key), tmp_path / "config.toml"
    if isinstance(value, Path):
        value = tmp_path / value
        value.touch()
    head = "" if not key.section else f"{HEADERS[key.section]}\n"
    first = {"actuator": "channels = [0]\n", "application": 'match = "a"\n'}
    needed = "" if key.name in ("channels", "match") else first.get(key.section, "")
    path.write_text(f"{head}{needed}{key.name} = {json.dumps(value, default=str)}\n")
    found = config.load(path)
    holders: tuple[Described, ...] = (found.settings, found.live, found.settings.parameters)
    holders += (*found.settings.actuators, *found.live.application_rules)
    (holder,) = (one for one in holders if isinstance(one, key.owner))
    assert getattr(holder, key.field) == value


@pytest.mark.parametrize("key", KEYS, ids=lambda key: f"{key.section}.{key.name}")
def test_a_running_daemon_does_what_the_schema_says_of_a_change(key: Any) -> None:
    three = (ActuatorSettings((0,)), ActuatorSettings((1,), "back"), ActuatorSettings((2,)))
    settings = Settings(actuators=three if key.owner is ActuatorSettings else ())
    live = LiveSettings(device="sink:a", offset_ms=5.0)
    changed, other = {key.field: another(key)}, (settings, live)
    if key.owner is ApplicationRule:
        rule = ApplicationRule(**{"match": "b", **changed})
        other = settings, replace(live, application_rules=(rule,))
    elif key.owner is LiveSettings:
        other = settings, replace(live, **changed)
    elif key.owner is ActuatorSettings:
        other = replace(settings, actuators=(*three[:2], replace(three[2], **changed))), live
    elif key.owner is TransformParameters:
        other = replace(settings, parameters=replace(settings.parameters, **changed)), live
    else:
        other = settings.choosing(**changed), live
    old, new = (
        RunConfig(parse_tap(live.tap[0]), parse_device(str(live.device)), settings, live)
        for settings, live in ((settings, live), other)
    )
    found = {change.name.lower() for change in changes_between(old, new)}
    assert len(found) == 1
    assert found <= {*KINDS[key.change]}


@pytest.mark.parametrize("command", ["run", "render", "replay", "demo"])
def test_help_says_of_every_key_what_it_means_and_its_default_in_this_command(command: str) -> None:
    text = " ".join(call(command, "--help").stdout.split())
    default = LIVE_DEFAULT if command in ("run", "demo") else OFFLINE_DEFAULT
    shown = [key for key in KEYS if key.flag and re.search(rf"{key.flag}\b(?!-)", text)]
    assert shown
    for key in shown:
        if key.field == "profile":
            key = replace(key, default=default, live_default=default)
        assert " ".join(key.help.split()) in text

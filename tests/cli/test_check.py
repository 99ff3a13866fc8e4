import json
import re
import time
from importlib.resources import files

import pytest

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.config.file import load
from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.config.toml_text import parse
from device.drive import ActuatorSettings
from tests.support.commands import call, document, listing, noise, refused, sound
from tests.support.data import table

RIG = (files("device.rig") / "consumer.toml").read_text("utf-8")
PROFILES_ALLOWED = ", ".join(PROFILES)


def mistakes(path):
    """Each mistake as (line number or 0, the rest), having found that there are some."""
    done = call("check", "--config", path)
    assert (done.code, done.stdout) == (2, ""), done
    assert done.stderr.endswith("\n")
    found = []
    for line in done.stderr.removesuffix("\n").split("\n"):
        matched = re.fullmatch(rf"cushion: error: {re.escape(str(path))}: (.*)", line)
        assert matched, done.stderr
        where = re.match(r"line (\d+): ", matched[1])
        number, what = (int(where[1]), matched[1][where.end() :]) if where else (0, matched[1])
        assert "; allowed: " in what
        found.append((number, what))
    return found


RANGE = "transform.window_s = 9 is out of range; allowed: 0.01 to 0.2 s"
WINDOW = "transform.window_s = {} is not a number; allowed: 0.01 to 0.2 s"
FIRST = "[[actuator]]\nchannels = [0]\n"
RULE = "[[application]]\nmatch = "
EFFECTS = "; allowed: the path of an audio_effects.xml"

TABLES = table("config-mistakes.toml")
MISTAKES = [
    *TABLES["mistakes"],
    *((*mistake, RANGE) for mistake in TABLES["out_of_range"]),
    *[
        (f"[transform]\nwindow_s = {value}", 2, WINDOW.format(value))
        for value in ('"0.05"', '"a b; allowed: all"', "true", "2020-01-01", "[0.05, 0.06]")
    ],
    *[
        (f"[transform]\nwindow_s = {value}", 2, "window_s")
        for value in ("inf", "-inf", "nan", "1e999", "1" + "0" * 400)
    ],
    *[
        (f"[transform]\namplitude_mapping = {value}", 2, f"{value} is not known; allowed: tonal,")
        for value in ('"loud"', "3", "true", '["energy"]')
    ],
    *[
        (f"profile = {value}", 1, f"is not known; allowed: {PROFILES_ALLOWED}")
        for value in ("3", '"""\nloud\n"""', '"lo\\nud"', '"loud\\u001b[31m"')
    ],
    *[
        (f"[[actuator]]\nchannels = {value}", 2, f"actuator[1].channels = {value} ")
        for value in ("[0.0]", "[true]", "[32]")
    ],
    *[
        (f"# effects\neffects_file = {value}", 2, f"effects_file = {value} {problem}{EFFECTS}")
        for value, problem in (
            *(('"none.xml"', "is not a file"), ('"."', "is not a file")),
            *(('""', "is not a path"), ("3", "is not a path")),
        )
    ],
]


@pytest.mark.parametrize(("text", "line", "words"), MISTAKES)
def test_a_mistake_is_a_line_with_place_and_what_is_allowed(config, tmp_path, text, line, words):
    (tmp_path / "bad.toml").write_text(RIG.replace("value = 0.18", "value = -0.18"))
    ((number, what),) = mistakes(config(f"{text}\n"))
    assert number == line
    assert words in what
    assert what.isprintable()


@pytest.mark.parametrize(
    "text",
    [
        'tap = "default"',
        'tap = "desktop"',
        'tap = ["app:a", "app:b"]',
        'tap = ["sink:x"]',
        'device = "usb:0d8c:0014:x"',
        "drop_in = true\noffset_ms = -500",
        '[applications]\ninclude = ["role:game", "a"]\nexclude = []',
        *("", "# nothing", "[transform]"),
    ],
)
def test_a_config_without_mistakes_passes(config, text):
    path = config(f"{text}\n")
    assert call("check", "--config", path).stdout == f"{path}: no mistakes\n"
    assert document("check", "--config", path) == []


def test_rendering_with_mistakes_names_the_first_and_how_many_more(config, tmp_path):
    path = config('\nprofile = "loud"\nvolume = 11\n[transform]\nwindow_s = 9\n')
    source = sound(tmp_path / "in.wav", noise(3_000))
    error = refused(call("render", source, tmp_path / "out.wav", "--config", path))
    assert f'line 2: profile = "loud" is not known; allowed: {PROFILES_ALLOWED}' in error
    assert "and 2 more" in error
    assert listing(tmp_path).keys() == {"in.wav", "config.toml"}


def test_broken_lines_are_reported_together_with_wrong_values(config):
    found = mistakes(
        config(
            'profile = "paper\n'  # no end of the string
            "damping = \n"
            "rig == 3\n"
            "[transform]\n"
            "window_s = 9\n"
            "= 7\n"
            "band_low_hz = 50\n"
            "band_low_hz = 60\n"
            "loud = 1\n"
        )
    )
    assert [line for line, _ in found] == [1, 2, 3, 5, 6, 8, 9]
    broken = [line for line, what in found if "is not TOML" in what]
    assert (broken, found[3][1]) == ([1, 2, 3, 6, 8], RANGE)
    assert found[6][1].startswith("transform.loud = 1 is an unknown key")


def test_a_broken_section_line_does_not_make_its_keys_unknown(config):
    found = mistakes(config("[transform\nwindow_s = 0.05\npartials_max = 99\n"))
    assert [line for line, _ in found] == [1, 3]
    assert "is not TOML" in found[0][1]
    assert found[1][1] == "transform.partials_max = 99 is out of range; allowed: 1 to 64"


def test_what_cannot_be_read_as_text_is_refused_and_one_mistake_in_a_document(tmp_path):
    (tmp_path / "utf-16").write_bytes(b"\xff\xfep\x00r\x00")
    (tmp_path / "bytes").write_bytes(bytes(range(256)))
    for name, words in {
        **dict.fromkeys(("utf-16", "bytes"), "is not UTF-8"),
        "none": "cannot be read (No such file",
        "": "cannot be read (Is a directory",
    }.items():
        error = refused(call("check", "--config", tmp_path / name))
        assert words in error
        assert str(tmp_path / name) in error
        done = call("check", "--config", tmp_path / name, "--json")
        (found,) = json.loads(done.stdout)
        assert (done.code, done.stderr) == (2, "")
        assert found["problem"].startswith(f"{tmp_path / name} ")


@pytest.mark.parametrize(
    "content",
    [
        pytest.param("a = " + "[" * 5_000 + "]" * 5_000, id="nested"),
        pytest.param("[transform]\nwindow_s = " + "9" * 5_000, id="5000 digits"),
        pytest.param("=\n" * 1_000, id="many"),
        pytest.param("a." * 100_000 + "b = 1", id="parts"),
        pytest.param("a" + " " * 300_000 + "b", id="spaces"),
        pytest.param("[a" + " " * 300_000 + "b", id="section"),
        pytest.param("\0\x0b\n" * 10, id="control characters"),
        pytest.param('profile = "loud"\rdamping = "on"\n', id="line ends of another age"),
    ],
)
def test_no_text_is_so_broken_that_checking_it_breaks(config, content):
    done = call("check", "--config", config(content))
    assert done.code == 2
    assert done.stderr
    for line in done.stderr.removesuffix("\n").split("\n"):
        assert line.startswith("cushion: error: ")
        assert "fault of cushion" not in line
        assert line.isprintable()


@pytest.mark.parametrize(
    ("variable", "place"),
    [("XDG_CONFIG_HOME", "cushion/config.toml"), ("HOME", ".config/cushion/config.toml")],
)
def test_the_users_config_is_looked_for_where_variables_say(tmp_path, monkeypatch, variable, place):
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    own, done = tmp_path / place, call("check")
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout == f"{own} does not exist: the defaults apply\n"
    assert call("check", "--json").stdout == "[]\n"
    own.parent.mkdir(parents=True)
    own.write_text('profile = "loud"\n')
    done = call("check")
    assert done.code == 2
    assert f"{own}: line 1: profile" in done.stderr


def test_a_rig_is_a_name_or_a_file_beside_the_config(config, tmp_path):
    (tmp_path / "mine.toml").write_text(RIG)
    assert load(config('rig = "consumer"\n')).settings.rig == "consumer"
    settings = load(config(f'rig = "mine.toml"\n{FIRST}rig = "mine.toml"\n')).settings
    assert settings.rig == settings.actuators[0].rig == str(tmp_path / "mine.toml")


@pytest.mark.parametrize("line", ["gain_db = -6  # {}", "[live]\ndevice = 'wav:{}'", "# {}"])
def test_dots_outside_of_keys_are_no_nesting(line):
    assert parse(line.format("." * 500))[1] == []


def test_what_is_not_said_of_an_actuator_is_the_default(config):
    left = '[[actuator]]\nsource = "left"\nchannels = [3]\nprotection = "on"\n'
    settings = load(config(f'{left}[[actuator]]\nsource = "all"\nchannels = [0]\n')).settings
    first = ActuatorSettings((3,), "left", protection="on")
    assert settings.actuators == (first, ActuatorSettings((0,)))
    assert settings.sources == ("mix", "left")


def test_rules_of_applications_keep_their_order_and_values(config):
    second = "[[application]]\nmatch = 'mpv'\nfeel = false\n"
    first = f'{RULE}"super*"\nprofile = "game"\ngain_db = -6\n'
    live = load(config(f"[live]\nfeel_calls_and_alerts = true\n{first}{second}")).live
    wanted = ApplicationRule("super*", "game", -6.0), ApplicationRule("mpv", feel=False)
    assert (live.feel_calls_and_alerts, live.application_rules) == (True, wanted)
    assert not load(config("")).live.feel_calls_and_alerts


@pytest.mark.parametrize("section", ["", "[transform]\n"])
def test_of_40_000_mistakes_the_first_are_listed_and_the_others_counted(config, section):
    path = config(section + "".join(f"key_{n} = {n}\n" for n in range(40_000)))
    begin_s = time.process_time()
    done = call("check", "--config", path, "--json")
    assert time.process_time() - begin_s <= 2.0
    found = json.loads(done.stdout)
    assert (done.code, done.stderr, len(found) <= 51) == (2, "", True)
    assert found[-1]["problem"] == f"has {40_001 - len(found)} more mistakes"
    told = call("check", "--config", path)
    assert told.stderr.count("\n") == len(found)
    assert len(done.stdout) <= 20_000 >= len(told.stderr)

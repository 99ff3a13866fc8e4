"""`cushion check`: every mistake of a config at once, each with key, line, value and what goes."""

import json
import re

import pytest

from audioflinger_hook.config.file import load
from device.drive import ActuatorSettings
from tests.support.commands import call, listing, noise, refused, sound
from tests.support.parameters import LIMITS

TOP_LEVEL = (
    "profile, damping, protection, exposure_cap, rig, model, tolerance, gain_db, effects_file, "
    "tap, device, "
    "offset_ms, drop_in, block_frames, realtime, engine, device_volume_db, [transform], "
    "[applications], [[actuator]]"
)

FIVE_MISTAKES = """\
# A config with five mistakes.
profile = "loud"

volume = 11
damping = "on"
[transform]
window_s = 9
partials_max = 2.5  # a whole number is wanted
band_low_hz = 50
"""

TEN_LIVE_MISTAKES = """\
tap = ["app:Game", "default"]
device = "usb:12"
offset_ms = -5
block_frames = 300
gain_db = 3
realtime = 1
volume = 3

[applications]
include = ["Game", ""]
exclude = "Game"
loud = 1
[transform]
window_s = 9
"""

EVERY_KEY = """\
profile = "paper"
damping = "auto"
protection = "on"
rig = "consumer"
gain_db = -3

[transform]
transform = "reference"
channels = "each"
window_s = 0.05
band_low_hz = 60
band_high_hz = 10_000.0
vibration_top_hz = 200
threshold_hz = 0.5
partials_max = 8
amplitude_mapping = "energy"
mapping = "jnd"
"""


@pytest.fixture
def config(tmp_path):
    """Writes a config, text or bytes, and returns its path."""

    def write(content):
        path = tmp_path / "config.toml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


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


# --- mistakes


def test_five_mistakes_are_reported_at_once_with_key_line_value_and_what_is_allowed(config):
    path = config(FIVE_MISTAKES)
    expected = [
        (2, 'profile = "loud" is not known; allowed: paper, cinema, game, music, speech'),
        (4, f"volume = 11 is an unknown key; allowed: {TOP_LEVEL}"),
        (5, 'damping = "on" is not known; allowed: off, auto'),
        (7, "transform.window_s = 9 is out of range; allowed: 0.01 to 0.2 s"),
        (8, "transform.partials_max = 2.5 is not a whole number; allowed: 1 to 64"),
    ]
    assert mistakes(path) == expected
    done = call("check", "--config", path, "--json")
    assert done.code == 2
    documents = json.loads(done.stdout)
    assert [(one["line"], one["key"], one["value"]) for one in documents] == [
        (2, "profile", '"loud"'),
        (4, "volume", "11"),
        (5, "damping", '"on"'),
        (7, "transform.window_s", "9"),
        (8, "transform.partials_max", "2.5"),
    ]
    for one, (_, what) in zip(documents, expected, strict=True):
        assert what.endswith(f"{one['problem']}; allowed: {one['allowed']}")


def test_mistakes_of_live_keys_are_found_together_with_all_others(config):
    found = mistakes(config(TEN_LIVE_MISTAKES))
    assert [line for line, _ in found] == [1, 2, 3, 4, 5, 6, 7, 10, 11, 12, 14]
    starts = (
        'tap = ["app:Game", "default"] are several taps, but not all are applications',
        'device = "usb:12" is not usb:VID:PID',
        "offset_ms = -5 is below 0 without drop_in; allowed: 0 to 1000 ms, or drop_in = true",
        "block_frames = 300 is not known; allowed: 128, 256, 512, 1024 frames",
        "gain_db = 3 is out of range; allowed: -60 to 0 dB",
        "realtime = 1 is not true or false; allowed: true, false",
        f"volume = 3 is an unknown key; allowed: {TOP_LEVEL}",
        'applications.include = ["Game", ""] must be a list of non-empty strings',
        'applications.exclude = "Game" must be a list of non-empty strings; allowed: ["NAME"',
        "applications.loud = 1 is an unknown key; allowed: include, exclude",
        "transform.window_s = 9 is out of range",
    )
    for (_, what), start in zip(found, starts, strict=True):
        assert what.startswith(start)


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("tap = 3", "is not a tap or a list of taps"),
        ("tap = []", "is an empty list"),
        ('tap = ["default", 3]', "is not a tap or a list of taps"),
        ('tap = ""', "has an empty name"),
        ('tap = "appp:x"', "has the unknown kind 'appp'"),
        ('tap = ["app:a", "app:"]', "has an empty name"),
        ("device = 3", "is not a device"),
        ('device = ""', "has an empty name"),
        ('device = "card:x"', "has the unknown kind 'card'"),
        ('offset_ms = "5"', "is not a number"),
        ("offset_ms = true", "is not a number"),
        ("offset_ms = nan", "is out of range"),
        ("offset_ms = 1000.5", "is out of range"),
        ("offset_ms = -500.5", "is out of range"),
        ('drop_in = "no"', "is not true or false"),
        ("block_frames = 256.0", "is not known"),
        ("block_frames = true", "is not known"),
        ("gain_db = -60.5", "is out of range"),
        ("gain_db = false", "is not a number"),
        ("gain_db = nan", "is out of range"),
        ("applications = 3", "is not a section"),
        ("applications.include = 3", "must be a list"),
        ('applications.exclude = [["a"]]', "must be a list"),
    ],
)
def test_every_live_key_takes_what_it_takes_and_nothing_else(config, line, wrong):
    ((number, what),) = mistakes(config(f"{line}\n"))
    assert number == 1
    assert f" {wrong}" in what


@pytest.mark.parametrize(
    "text",
    [
        'tap = "default"',
        'tap = "desktop"',
        'tap = ["app:a", "app:b"]',
        'tap = ["sink:x"]',
        'device = "usb:0d8c:0014:x"',
        "drop_in = true\noffset_ms = -500",
        "offset_ms = 1000",
        "block_frames = 128",
        "gain_db = -60",
        "realtime = false",
        '[applications]\ninclude = ["role:game", "a"]\nexclude = []',
    ],
)
def test_what_live_sound_can_be_told_passes(config, text):
    assert call("check", "--config", config(f"{text}\n")).code == 0


def test_rendering_with_mistakes_names_the_first_and_how_many_more(config, tmp_path):
    source = sound(tmp_path / "in.wav", noise(3_000))
    path = config(FIVE_MISTAKES)
    error = refused(call("render", source, tmp_path / "out.wav", "--config", path))
    assert (
        'line 2: profile = "loud" is not known; allowed: paper, cinema, game, music, speech'
        in error
    )
    assert "and 4 more" in error
    assert listing(tmp_path).keys() == {"in.wav", "config.toml"}


@pytest.mark.parametrize("name", LIMITS)
def test_every_number_has_its_range_and_its_edges_are_in_it(config, name):
    # Alone, so that no two numbers contradict each other but for the named ones.
    low, high = LIMITS[name].low, LIMITS[name].high
    whole = name == "partials_max"
    little = 0.001 * (abs(low) + abs(high))
    beyond = [low - 1, high + 1] if whole else [low - little, high + little]
    for value in beyond:
        ((line, what),) = mistakes(config(f"[transform]\n{name} = {value!r}\n"))
        assert line == 2
        assert what.startswith(f"transform.{name} = {value!r} is out of range; allowed: {low:g} to")
    for value in (low, high):
        companion = {"band_high_hz": "band_low_hz = 20", "band_low_hz": "band_high_hz = 20000"}
        text = f"[transform]\n{name} = {value!r}\n{companion.get(name, '')}\n"
        if name == "vibration_top_hz":
            text += "window_s = 0.2\n"
        assert call("check", "--config", config(text)).code == 0


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ('"0.05"', '"0.05"'),
        ('"a b; allowed: all"', '"a b; allowed: all"'),
        ("true", "true"),
        ("2020-01-01", "2020-01-01"),
        ("[0.05, 0.06]", "[0.05, 0.06]"),
    ],
)
def test_what_is_no_number_is_shown_as_it_was_written(config, value, shown):
    found = mistakes(config(f"[transform]\nwindow_s = {value}\n"))
    what = f"transform.window_s = {shown} is not a number; allowed: 0.01 to 0.2 s"
    assert found == [(2, what)]


@pytest.mark.parametrize(
    "value", ["inf", "-inf", "nan", "1e999", pytest.param("1" + "0" * 400, id="1e400 as a whole")]
)
def test_no_number_is_too_large_to_be_refused(config, value):
    ((line, what),) = mistakes(config(f"[transform]\nwindow_s = {value}\n"))
    assert line == 2
    assert "window_s" in what


@pytest.mark.parametrize("value", ['"loud"', "3", "true", '["energy"]'])
def test_a_word_of_the_transform_that_is_none_of_its_choices_is_a_mistake(config, value):
    found = mistakes(config(f"[transform]\namplitude_mapping = {value}\n"))
    what = f"transform.amplitude_mapping = {value} is not known; allowed: tonal, energy"
    assert found == [(2, what)]


def test_numbers_that_contradict_each_other_are_a_mistake(config):
    found = mistakes(config("[transform]\nband_high_hz = 300\nband_low_hz = 200\n"))
    assert found == [
        (
            2,
            "transform.band_high_hz = 300 is under twice band_low_hz=200; allowed: at least 400 Hz",
        )
    ]


def test_names_that_are_no_names_are_mistakes(config):
    refused_form = "is not known; allowed: live, reference; did you mean live?"
    found = mistakes(config('profile = 3\n[transform]\ntransform = "Live"\nchannels = true\n'))
    assert found == [
        (1, "profile = 3 is not known; allowed: paper, cinema, game, music, speech"),
        (3, f'transform.transform = "Live" {refused_form}'),
        (4, "transform.channels = true is not known; allowed: mono, each"),
    ]


@pytest.mark.parametrize(
    ("text", "line", "key"),
    [
        ("[tranform]\nwindow_s = 0.05\n", 1, "tranform"),
        ("[transform]\nwindow = 0.05\n", 2, "transform.window"),
        ('[transform]\nprofile = "paper"\n', 2, "transform.profile"),
        ("window_s = 0.05\n", 1, "window_s"),
        ("\n'profil' = 'paper'\n", 2, "profil"),
    ],
)
def test_a_key_that_does_not_exist_is_a_mistake(config, text, line, key):
    ((number, what),) = mistakes(config(text))
    assert number == line
    assert what.startswith(key)
    unknown = "section" if key == "tranform" else "key"
    assert f"is an unknown {unknown}; allowed: " in what


@pytest.mark.parametrize(
    "text",
    [
        "transform = 3\n",
        "[[transform]]\nwindow_s = 0.05\n",
    ],
)
def test_a_section_that_is_none_is_a_mistake(config, text):
    ((line, what),) = mistakes(config(text))
    assert line == 1
    assert what.endswith("is not a section; allowed: [transform]")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[transform]\n\nwindow_s = 9\n", 3),
        ("\r\n[transform]\r\nwindow_s = 9\r\n", 3),
        ("\ufeff[transform]\nwindow_s = 9\n", 2),
        ("[ transform ]  # [x]\n\twindow_s\t=\t9\n", 2),
        ('["transform"]\n"window_s" = 9\n', 2),
        ("transform.window_s = 9\n", 1),
        ("\ntransform . 'window_s' = 9\n", 2),
        ("\ntransform = {window_s = 9}\n", 2),
        ('#window_s = 1\nprofile = "paper"\n[transform]\nwindow_s = 9\n', 4),
    ],
)
def test_the_line_is_right_however_the_key_is_written(config, text, line):
    found = mistakes(config(text))
    assert found == [(line, "transform.window_s = 9 is out of range; allowed: 0.01 to 0.2 s")]


@pytest.mark.parametrize(
    "text",
    [
        'profile = """\nloud\n"""\n',
        'profile = "lo\\nud"\n',
        'profile = "loud\\u001b[31m"\n',
    ],
)
def test_a_value_of_several_lines_is_still_one_line_of_message(config, text):
    ((line, what),) = mistakes(config(text))
    assert line == 1
    assert what.endswith("is not known; allowed: paper, cinema, game, music, speech")
    assert what.isprintable()


# --- what is not even TOML


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
    assert broken == [1, 2, 3, 6, 8]
    assert found[3][1] == "transform.window_s = 9 is out of range; allowed: 0.01 to 0.2 s"
    assert found[6][1].startswith("transform.loud = 1 is an unknown key")


def test_a_broken_section_line_does_not_make_its_keys_unknown(config):
    found = mistakes(config("[transform\nwindow_s = 0.05\npartials_max = 99\n"))
    assert [line for line, _ in found] == [1, 3]
    assert "is not TOML" in found[0][1]
    assert found[1][1] == "transform.partials_max = 99 is out of range; allowed: 1 to 64"


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfep\x00r\x00",  # UTF-16
        bytes(range(256)),
    ],
)
def test_what_is_not_text_is_refused(config, content):
    assert "is not UTF-8 text" in refused(call("check", "--config", config(content)))


@pytest.mark.parametrize(
    "content",
    [
        pytest.param("a = " + "[" * 5_000 + "]" * 5_000, id="nested"),
        pytest.param("[transform]\nwindow_s = " + "9" * 5_000, id="5000 digits"),
        pytest.param("=\n" * 1_000, id="many"),
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


# --- no mistakes, no file


@pytest.mark.parametrize("text", ["", "# nothing\n", "[transform]\n", EVERY_KEY])
def test_a_config_without_mistakes_passes(config, text):
    path = config(text)
    assert call("check", "--config", path).stdout == f"{path}: no mistakes\n"
    done = call("check", "--config", path, "--json")
    assert (done.code, json.loads(done.stdout), done.stderr) == (0, [], "")


@pytest.mark.parametrize("cap", ["off", "action", "limit"])
def test_a_cap_of_the_exposure_is_one_of_three(config, cap):
    assert load(config(f'exposure_cap = "{cap}"\n')).settings.exposure_cap == cap
    error = refused(call("check", "--config", config('exposure_cap = "0.5"\n')))
    assert 'exposure_cap = "0.5" is not known; allowed: off, action, limit' in error


def test_every_key_of_a_config_has_its_effect(config, tmp_path):
    source = sound(tmp_path / "in.wav", noise(20_000, 2))
    lines = EVERY_KEY.splitlines()
    rendered = set()
    for left_out in [line for line in lines if "_" in line] + ["transform", "mapping"]:
        path = config("\n".join(line for line in lines if not line.startswith(left_out)))
        assert call("render", source, tmp_path / "out.wav", "--config", path).code == 0
        rendered.add((tmp_path / "out.wav").read_bytes())
    assert len(rendered) == 10


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.toml", "cannot be read (No such file or directory)"),
        (".", "cannot be read (Is a directory)"),
    ],
)
def test_a_config_that_is_named_must_be_there(tmp_path, name, words):
    error = refused(call("check", "--config", tmp_path / name))
    assert words in error
    assert str(tmp_path / name) in error


@pytest.mark.parametrize(
    ("variable", "place"),
    [("XDG_CONFIG_HOME", "cushion/config.toml"), ("HOME", ".config/cushion/config.toml")],
)
def test_the_users_own_config_is_looked_for_where_the_environment_says(
    tmp_path, monkeypatch, variable, place
):
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    own = tmp_path / place
    done = call("check")
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout == f"{own} does not exist: the defaults apply\n"
    assert call("check", "--json").stdout == "[]\n"
    own.parent.mkdir(parents=True)
    own.write_text('profile = "loud"\n')
    done = call("check")
    assert done.code == 2
    assert f"{own}: line 1: profile" in done.stderr


# --- rigs

RIG = """\
[dac]
bits = 16
full_scale_v = 1.0
[amplifier]
gain = 2.0
output_limit_v = 10.0
source_impedance_ohm = 0.0
[actuator]
moving_mass_kg = 0.1
resonance_hz = 50.0
q_mechanical = 4.0
force_factor_n_per_a = 8.0
resistance_ohm = 4.0
inductance_h = 1e-3
x_max_m = 1e-3
"""


def test_a_rig_is_a_name_or_a_file_beside_the_config(config, tmp_path):
    (tmp_path / "mine.toml").write_text(RIG)
    path = config('rig = "mine.toml"\n')
    assert load(path).settings.rig == str(tmp_path / "mine.toml")
    assert load(config('rig = "consumer"\n')).settings.rig == "consumer"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ('"loud"', "is not known; allowed: paper, consumer, or a file, NAME.toml"),
        ("3", "is not a name"),
        ('"none.toml"', "cannot be used (cannot read the rig file"),
        ('"bad.toml"', "actuator.moving_mass_kg=-0.1 must be above 0"),
    ],
)
def test_a_rig_that_cannot_be_is_a_mistake_of_its_line(config, tmp_path, value, words):
    (tmp_path / "bad.toml").write_text(RIG.replace("kg = 0.1", "kg = -0.1"))
    ((line, what),) = mistakes(config(f"gain_db = -3\nrig = {value}\n"))
    assert line == 2
    assert words in what


# --- actuators


TEN_MISTAKES_OF_ACTUATORS = """\
[[actuator]]
source = "middle"
channels = [0]
gain_db = 3

[[actuator]]
channels = [0, "front-left"]
delay_ms = 900
volume = 3

[[ actuator ]]  # no channels
polarity = "up"
rig = "loud"
damping = "on"
[transform]
channels = "each"
"""


def test_mistakes_of_actuators_are_found_at_once_with_the_table_s_number(config):
    found = mistakes(config(TEN_MISTAKES_OF_ACTUATORS))
    starts = [
        (2, 'actuator[1].source = "middle" is not known; allowed: mix, left, right, front, back'),
        (4, "actuator[1].gain_db = 3 is out of range; allowed: -60 to 0 dB"),
        (7, 'actuator[2].channels = [0, "front-left"] wants channel 0, which drives actuator 1'),
        (8, "actuator[2].delay_ms = 900 is out of range; allowed: 0 to 500 ms"),
        (9, "actuator[2].volume = 3 is an unknown key; allowed: channels, source, rig"),
        (11, "actuator[3].channels is missing; allowed: a list of channels"),
        (12, 'actuator[3].polarity = "up" is not known; allowed: normal, inverted'),
        (13, 'actuator[3].rig = "loud" is not known'),
        (14, 'actuator[3].damping = "on" is not known; allowed: off, auto'),
        (16, 'transform.channels = "each" cannot be used with actuators; allowed: mono'),
    ]
    assert len(found) == len(starts)
    for (line, what), (wanted, start) in zip(found, starts, strict=True):
        assert line == wanted
        assert what.startswith(start)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("actuator = 3\n", "actuator"),
        ("actuator = []\n", "actuator"),
        ("[actuator]\nchannels = [0]\n", "actuator"),
        ('actuator = [{channels = [0]}, "left"]\n', "actuator"),
        ('actuator = [{channels = "0"}]\n', "actuator[1].channels"),
        ("[[actuator]]\nchannels = [0.0]\n", "actuator[1].channels"),
        ("[[actuator]]\nchannels = [true]\n", "actuator[1].channels"),
        ("[[actuator]]\nchannels = [0, 0]\n", "actuator[1].channels"),
        ("[[actuator]]\nchannels = [32]\n", "actuator[1].channels"),
        ("[[actuator]]\nchannels = [0]\ngain_db = true\n", "actuator[1].gain_db"),
        ("[[actuator]]\nchannels = [0]\nrig = 3\n", "actuator[1].rig"),
        ("[[actuator]]\nchannels = [0]\n[[actuator\nchannels = [1]\n", "[[actuator"),
    ],
)
def test_an_actuator_that_is_none_is_one_mistake(config, text, key):
    ((_, what),) = mistakes(config(text))
    assert what.partition(" ")[0] == key


def test_actuators_are_read_with_their_defaults_and_rigs_beside_the_config(config, tmp_path):
    for line in ('rig = "seat.toml"\n', ""):
        path = config(f'rig = "consumer"\n[[actuator]]\nsource = "all"\nchannels = [1, 0]\n{line}')
        if line:
            ((number, what),) = mistakes(path)
            assert (number, what.partition(" ")[0]) == (5, "actuator[1].rig")
    path = config(
        '[[actuator]]\nsource = "left"\nchannels = ["rear-left", 3]\ngain_db = -3\n'
        'polarity = "inverted"\ndelay_ms = 5\nrig = "consumer"\nprotection = "on"\n'
        '[[actuator]]\nsource = "all"\nchannels = [0]\n'
    )
    first, second = load(path).settings.actuators
    assert first == ActuatorSettings(
        ("rear-left", 3), "left", "consumer", -3.0, "inverted", 5.0, None, "on"
    )
    assert second == ActuatorSettings((0,))
    assert load(path).settings.sources == ("mix", "left")

import functools

import numpy as np
import pytest

from audioflinger_hook import scenes
from audioflinger_hook.sources import address
from tests.support.commands import RATE, call, cushion, document, noise, refused, sound, start
from tests.support.signals import five_tones, silence, tone

PRINCIPAL_KEYS = ["audio_hz", "amplitude", "bandwidth_hz", "r", "vibration_hz"]

inspected = functools.partial(document, "inspect")


def test_silence_has_units_and_nothing_principal_in_them(tmp_path):
    source = sound(tmp_path / "in.wav", silence(0.2, RATE))
    assert [unit["principal"] for unit in inspected(source)] == [[]] * 5
    table = [line.split() for line in call("inspect", source).stdout.splitlines()]
    assert table[1:3] == [["0", "0.000000", "-"], ["1", "0.046437", "-"]]


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [8_000, 1_000, 22_050, 44_100, 48_000, 96_000])
def test_the_start_that_is_printed_for_a_unit_finds_that_unit(tmp_path, samplerate):
    source = sound(tmp_path / "in.wav", tone(440.0, 2.0, samplerate, 0.5), samplerate)
    units = inspected(source)
    rows = [line.split() for line in call("inspect", source).stdout.splitlines()[1:]]
    heads = [row for row in rows if len(row) == 7]  # the first line of each unit
    for unit, (number, start_s, *_) in zip(units, heads, strict=True):
        assert unit["unit"] == int(number)
        assert inspected(source, "--at", repr(unit["start_s"])) == [unit]
        assert inspected(source, "--at", start_s) == [unit]


def test_a_time_that_is_none_or_after_the_sound_is_refused_with_the_end_of_the_sound(tmp_path):
    source = sound(tmp_path / "in.wav", noise(RATE))
    for at_s in ("1.0", "1.0001", "86400", "1e30", "1e308"):
        assert "0 to 1.000 s" in refused(call("inspect", source, "--at", at_s))
    for at_s in ("-1", "-0.001", "nan", "inf", "soon", "", "1,5"):
        error = refused(call("inspect", source, f"--at={at_s}"))
        assert f"{at_s!r} is not a time; allowed: 0 seconds or more" in error


def test_the_table_says_what_json_says(tmp_path):
    source = sound(tmp_path / "in.wav", five_tones(0.5, RATE))
    units = inspected(source)
    assert {tuple(unit) for unit in units} == {("unit", "start_s", "principal")}
    assert {tuple(one) for unit in units for one in unit["principal"]} == {(*PRINCIPAL_KEYS,)}
    done = call("inspect", source)
    assert (done.code, done.stderr) == (0, "")
    head, *lines = done.stdout.splitlines()
    assert " ".join(head.split()) == "unit start s audio Hz amplitude width Hz r vibration Hz"
    rows = [line.split() for line in lines]
    assert len(rows) == sum(max(1, len(unit["principal"])) for unit in units)
    printed = [[float(cell) for cell in row[-5:]] for row in rows]
    expected = [[one[key] for key in PRINCIPAL_KEYS] for unit in units for one in unit["principal"]]
    assert np.allclose(printed, expected, rtol=0.0, atol=0.0051)


@pytest.mark.exhaustive
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    source = sound(tmp_path / "in.wav", noise(20 * RATE))  # far more lines than a pipe holds
    with start("inspect", source) as process:
        assert process.stdout
        assert process.stderr
        assert process.stdout.readline().split()[:2] == ["unit", "start"]
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


@pytest.fixture(autouse=True, scope="module")
def one_scene():
    """The demo scene, which cannot be changed, is made once for all tests here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(address, "demo_scene", functools.cache(scenes.demo_scene))
        yield


def dumped(*options, **process):
    done = cushion("dump", *options, **process) if process else call("dump", *options)
    assert (done.code, done.stderr) == (0, "")
    return [line.strip() for line in done.stdout.splitlines()]


def tracks_of(lines):
    """By name, the row of each track as column -> cell."""
    (head,) = [number for number, line in enumerate(lines) if line.startswith("Id ")]
    columns, rows = lines[head].replace("L dB", "LdB").replace("R dB", "RdB").split(), {}
    for line in lines[head + 1 :]:
        cells = line.split()
        if not cells[0].isdigit() or len(cells) != len(columns):
            break
        rows[cells[2]] = dict(zip(columns, cells, strict=True))
    return rows


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("at_s", "states"),
    [
        (1.0, {"engine": "active", "footsteps": "idle"}),
        (3.0, {"engine": "paused", "footsteps": "idle"}),
        (5.5, {"engine": "stopped", "footsteps": "active", "speech": "idle"}),
        (9.5, {"speech": "stopped", "explosion": "idle"}),
        (12.5, {"explosion": "active", "chord": "active"}),
    ],
)
def test_the_demos_tracks_are_in_the_state_that_the_scene_has_at_that_moment(at_s, states):
    lines = dumped("--tap", "scene:demo", "--at", at_s)
    rows = tracks_of(lines)
    for name, state in states.items():
        assert (rows[name]["S"], rows[name]["Undr"]) == (state, "0")
        assert rows[name]["Active"] == ("yes" if state == "active" else "no")
    active = sum(row["Active"] == "yes" for row in rows.values())
    assert f"5 Tracks of which {active} are active" in lines
    assert "Total cycles: 0" in dumped("--tap", "scene:demo", "--at", 0.0)


def test_a_dump_shows_the_mix_and_the_effect_after_a_second_if_nothing_is_said():
    lines = dumped()
    expected = {"Output thread (MIXER):", "Sample rate: 48000 Hz", "Frames written: 48128"}
    expected |= {"1 effects for session 0", "Effect 0: Haptic Cushion", "- form: live"}
    assert expected <= {*lines}
    assert any(line.startswith("Cycle time of 188 cycles") for line in lines)
    assert max(map(len, call("dump").stdout.splitlines())) <= 120


@pytest.mark.exhaustive
def test_a_file_is_one_track_and_its_end_ends_the_dump(tmp_path):
    sound(tmp_path / "in.wav", noise(11_025, 3), 44_100)
    (tmp_path / "c.toml").write_text('[transform]\ntransform = "reference"\nchannels = "each"\n')
    lines = dumped("--tap", "file:in.wav", "--config", "c.toml", cwd=tmp_path)
    assert {"Haptic channel count: 3", "Frames written: 11025", "- form: reference"} <= {*lines}
    assert tracks_of(lines)["tap"]["S"] in ("stopping", "stopped")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *(("--at 100", "allowed: 0 to 15.000 s"), ("--tap capture:/none", "does not exist")),
        *(("--tap scene:demo --config /none.toml", "cannot be read"), ("scene:demo", "scene:demo")),
    ],
)
def test_what_cannot_be_dumped_is_an_error_of_one_line(line, words):
    assert words in refused(call("dump", *line.split()))

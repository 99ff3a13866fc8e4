"""`cushion dump`: threads, tracks and effects at a moment of the sound."""

from __future__ import annotations

import functools

import pytest

from audioflinger_hook import scenes
from audioflinger_hook.sources import address
from tests.support.commands import call, cushion, noise, refused, sound


@pytest.fixture(autouse=True)
def one_scene(monkeypatch):
    """The demo scene, which cannot be changed, is made once for all tests here."""
    monkeypatch.setattr(address, "demo_scene", made_once)


made_once = functools.cache(scenes.demo_scene)


def dumped(*options):
    """The lines of a dump that works and has nothing to warn of."""
    done = call("dump", *options)
    assert (done.code, done.stderr) == (0, "")
    return [line.strip() for line in done.stdout.splitlines()]


def tracks_of(lines):
    """By name, the row of each track as column -> cell."""
    (head,) = [number for number, line in enumerate(lines) if line.startswith("Id ")]
    columns = lines[head].replace("L dB", "LdB").replace("R dB", "RdB").split()
    rows = {}
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
        (0.0, {"engine": "idle", "chord": "idle"}),
        (0.1, {"engine": "idle", "chord": "idle"}),
        (1.0, {"engine": "active", "footsteps": "idle"}),
        (3.0, {"engine": "paused", "footsteps": "idle"}),
        (3.5, {"engine": "active", "footsteps": "idle"}),
        (5.5, {"engine": "stopped", "footsteps": "active", "speech": "idle"}),
        (9.5, {"speech": "stopped", "explosion": "idle"}),
        (12.5, {"explosion": "active", "chord": "active"}),
    ],
)
def test_the_demos_tracks_are_in_the_state_that_the_scene_has_at_that_moment(at_s, states):
    lines = dumped("--tap", "scene:demo", "--at", at_s)
    if at_s == 0.0:
        assert "Total cycles: 0" in lines
        return
    rows = tracks_of(lines)
    assert {name: rows[name]["S"] for name in states} == states
    for name, state in states.items():
        assert rows[name]["Active"] == ("yes" if state == "active" else "no")
        assert rows[name]["Undr"] == "0"
    active = sum(row["Active"] == "yes" for row in rows.values())
    assert f"5 Tracks of which {active} are active" in lines


@pytest.mark.exhaustive
def test_the_demos_tracks_have_their_own_rates_and_formats():
    rows = tracks_of(dumped("--tap", "scene:demo"))
    assert {name: (row["Format"], row["Chn"], row["SRate"]) for name, row in rows.items()} == {
        "engine": ("i16", "2", "44100"),
        "footsteps": ("i24", "2", "32000"),
        "speech": ("i16", "1", "16000"),
        "explosion": ("float", "2", "48000"),
        "chord": ("i32", "2", "96000"),
    }


def test_a_dump_shows_the_mix_and_the_effect_after_a_second_if_nothing_is_said():
    lines = dumped()
    for expected in (
        "Output thread (MIXER):",
        "Sample rate: 48000 Hz",
        "Frames written: 48128",  # whole cycles
        "1 effects for session 0",
        "Effect 0: Haptic Cushion",
        "- form: live",
    ):
        assert expected in lines
    assert any(line.startswith("Cycle time of 188 cycles") for line in lines)


@pytest.mark.exhaustive
def test_a_file_is_one_track_and_its_end_ends_the_dump(tmp_path):
    sound(tmp_path / "in.wav", noise(11_025, 3), 44_100)
    (tmp_path / "c.toml").write_text('[transform]\ntransform = "reference"\nchannels = "each"\n')
    done = cushion("dump", "--tap", "file:in.wav", "--config", "c.toml", cwd=tmp_path)
    assert (done.code, done.stderr) == (0, "")
    lines = [line.strip() for line in done.stdout.splitlines()]
    assert "Haptic channel count: 3" in lines
    assert "Frames written: 11025" in lines
    assert "- form: reference" in lines
    assert tracks_of(lines)["tap"]["S"] in ("stopping", "stopped")


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--tap", "default"], 3, "this command cannot capture live sound"),
        (["--tap", "app:x"], 3, "cannot capture live sound"),
        (["--tap", "scene:x"], 2, "unknown scene"),
        (["--at", "100"], 2, "allowed: 0 to 15.000 s"),
        (["--tap", "file:/none.wav"], 2, "does not exist"),
        (["--tap", "capture:/none"], 2, "does not exist"),
        (["--tap", "usb:1"], 2, "unknown kind 'usb'"),
        (["--tap", "scene:demo", "--at", "-1"], 2, "is not a time"),
        (["--tap", "scene:demo", "--config", "/none.toml"], 2, "cannot be read"),
        (["scene:demo"], 2, "scene:demo"),
    ],
)
def test_what_cannot_be_dumped_is_an_error_of_one_line(options, code, words):
    assert words in refused(call("dump", *options), code)

"""`cushion dump`: threads, tracks and effects at a moment of the sound."""

import functools

import pytest

from audioflinger_hook import scenes
from audioflinger_hook.sources import address
from tests.support.commands import call, cushion, noise, refused, sound


@pytest.fixture(autouse=True, scope="module")
def one_scene():
    """The demo scene, which cannot be changed, is made once for all tests here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(address, "demo_scene", functools.cache(scenes.demo_scene))
        yield


def dumped(*options, **process):
    """The lines of a dump that works and has nothing to warn of."""
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

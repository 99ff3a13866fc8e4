import json

import numpy as np
import pytest
import soundfile

from audioflinger_hook.capture import CaptureWriter
from tests.support.commands import RATE, call, cushion, listing, noise, refused, sound, vibration


@pytest.fixture
def source(tmp_path):
    return sound(tmp_path / "in.wav", noise(4_800, 2))


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "cap"
    with CaptureWriter(folder) as writer:
        for seed in range(20):
            writer.write_buffer("tap", noise(480, 2, seed).astype(np.float32), RATE, 0.01 * seed)
    return folder


def warned(folder, out):
    """The report and the warnings of a replay that works although something is wrong."""
    done = call("replay", folder, out, "--json")
    assert done.code == 0, done
    lines = done.stderr.splitlines()
    assert lines
    assert all(line.startswith("cushion: warning: ") for line in lines)
    return json.loads(done.stdout), "\n".join(lines)


def test_what_is_no_capture_is_refused(tmp_path, source):
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "index.jsonl").write_text("[]\n")
    before = listing(tmp_path)
    for path, words in {
        tmp_path / "none": "does not exist",
        source: "is not a folder",
        tmp_path / "empty": "is not a capture",
        tmp_path / "other": "is not a capture",
    }.items():
        tap = ("--tap", f"capture:{path}")
        out, new = tmp_path / "out.wav", tmp_path / "new"
        for command in (("replay", path, out), ("capture", new, *tap), ("dump", *tap)):
            assert words in refused(call(*command))
    assert listing(tmp_path) == before
    assert not (tmp_path / "new").exists()


WAVE = 94, 480 * 8
"""Bytes of a segment's header, and of a buffer."""


@pytest.mark.parametrize(
    ("damage", "words", "buffers", "gaps"),
    [
        ("no index", "index.jsonl is missing or unreadable", 20, 0),
        ("other samples", "damaged and left out: 1 buffer of stream tap", 19, 1),
        ("a short segment", "damaged at the end: 10 buffers", 10, 0),
    ],
)
def test_what_is_damaged_is_left_out_with_a_warning(tmp_path, folder, damage, words, buffers, gaps):
    assert call("replay", folder, tmp_path / "whole.wav").code == 0
    whole = vibration(tmp_path / "whole.wav")
    content = bytearray((folder / "tap-0001.wav").read_bytes())
    if damage == "no index":
        (folder / "index.jsonl").unlink()
    elif damage == "other samples":
        content[WAVE[0] + 3 * WAVE[1] + 17] ^= 0x40
    else:
        del content[WAVE[0] + 10 * WAVE[1] + 100 :]
    (folder / "tap-0001.wav").write_bytes(content)
    report, warnings = warned(folder, tmp_path / "out.wav")
    assert words in warnings
    assert (report["frames"], report["discontinuities"]) == (buffers * 480, gaps)
    if not gaps:
        end = -2_300 if buffers < 20 else None  # the last window, which silence follows
        made = vibration(tmp_path / "out.wav")[:end]
        assert np.array_equal(made, whole[: len(made)])


def test_an_output_of_a_replay_that_cannot_be_written_is_refused(tmp_path, folder):
    before, out = listing(folder), tmp_path / "out.wav"
    for output, words in (
        ([tmp_path / "none" / "out.wav"], f"folder {tmp_path}/none does not exist"),
        ([tmp_path], "is a folder"),
        ([folder], "name two files"),
        ([out, "--acceleration", out], "name two files"),
    ):
        assert words in refused(call("replay", folder, *output))
    for speed in ("2", "0", "fast", "", "1.0"):
        error = refused(call("replay", folder, out, "--speed", speed))
        assert f"speed='{speed}' is not known; allowed: max, 1" in error
    assert (listing(tmp_path), listing(folder)) == ({}, before)


def test_a_replay_does_not_write_over_the_capture_that_it_reads(tmp_path, folder):
    before = listing(folder)
    links = {"1.wav": folder / "tap-0001.wav", "2.wav": folder / "index.jsonl"}
    for name, target in links.items():
        (tmp_path / name).symlink_to(target)
        for path in (target, tmp_path / name):
            for output in ([path], [tmp_path / "out.wav", "--acceleration", path]):
                assert "name two files" in refused(call("replay", folder, *output))
    assert (listing(folder), listing(tmp_path).keys()) == (before, links.keys())
    assert call("replay", folder, folder / "vibration.wav").code == 0  # beside it is its own matter


def test_a_capture_is_made_in_a_new_or_empty_folder_only(tmp_path, source, folder):
    before = listing(folder)
    for place, tap, words in (
        (folder, f"file:{source}", "not empty"),
        (folder, f"capture:{folder}", "not empty"),
        (source, f"file:{source}", "not a folder"),
        (tmp_path / "none" / "cap", f"file:{source}", f"folder {tmp_path}/none does not exist"),
    ):
        assert words in refused(call("capture", place, "--tap", tap))
    assert listing(folder) == before
    assert not (tmp_path / "none").exists()
    (tmp_path / "empty").mkdir()
    assert call("capture", tmp_path / "empty", "--tap", f"file:{source}").code == 0


@pytest.mark.exhaustive
@pytest.mark.parametrize("options", [[], ["--tap", "default"], ["--tap", "speakers"]])
def test_without_a_sound_server_nothing_that_plays_is_captured(tmp_path, options):
    env = {"PULSE_SERVER": f"unix:{tmp_path / 'none'}"}
    done = cushion("capture", tmp_path / "cap", *options, env=env)
    # 3 where libpulse is not even installed
    assert "sound server" in refused(done, 4) if done.code == 4 else refused(done, 3)
    assert not (tmp_path / "cap").exists()


@pytest.mark.parametrize(
    ("tap", "words"),
    [
        ("usb:1", "unknown kind 'usb'"),
        ("file:", "has an empty name"),
        ("default:x", "has a name"),
        ("", "has an empty name"),
        ("scene:other", "unknown scene"),
        ("file:/none.wav", "does not exist"),
        ("folder/film.wav", "did you mean file:folder/film.wav?"),
        ("app:Firefox", "this command cannot capture live sound"),
        *((tap, "this command cannot capture live sound") for tap in ("default", "sink:x", "x")),
    ],
)
def test_a_tap_that_cannot_be_heard_is_refused(tmp_path, tap, words):
    live = "live" in words
    assert words in refused(call("dump", "--tap", tap), 3 if live else 2)
    if not live or tap.startswith("app:"):
        assert words in refused(call("capture", tmp_path / "cap", "--tap", tap), 3 if live else 2)
    assert not (tmp_path / "cap").exists()


def test_wrong_seconds_are_refused(tmp_path, source):
    options = ["capture", tmp_path / "cap", "--tap", f"file:{source}"]
    for seconds in ("-1", "nan", "inf", "soon", ""):
        for command in ([*options, f"--seconds={seconds}"], ["dump", f"--at={seconds}"]):
            assert "is not a time; allowed: 0 seconds" in refused(call(*command))
    assert "above 0 seconds" in refused(call(*options, "--seconds=0"))
    assert not (tmp_path / "cap").exists()


@pytest.mark.exhaustive
def test_a_full_disk_ends_a_capture_that_is_replayed_up_to_there(tmp_path, small_disk):
    error = refused(call("capture", small_disk / "cap", "--tap", "scene:demo"), 5)
    assert "the disk is full" in error
    assert "it can be replayed up to there" in error
    report, warnings = warned(small_disk / "cap", tmp_path / "out.wav")
    assert report["buffers"] > 3
    assert "it was cut off" in warnings
    assert soundfile.info(tmp_path / "out.wav").frames == report["buffers"] * 256

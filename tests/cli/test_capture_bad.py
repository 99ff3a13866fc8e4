"""What goes wrong around captures: one line, a code, and nothing harmed."""

from __future__ import annotations

import json
import os
import resource
import subprocess

import numpy as np
import pytest
import soundfile

from audioflinger_hook.capture import Capture, CaptureWriter
from tests.support.commands import RATE, call, cushion, listing, noise, refused, sound, vibration


@pytest.fixture
def source(tmp_path):
    return sound(tmp_path / "in.wav", noise(4_800, 2))


@pytest.fixture
def folder(tmp_path):
    """A capture of 20 buffers of stereo noise."""
    folder = tmp_path / "cap"
    with CaptureWriter(folder) as writer:
        for seed in range(20):
            frames = noise(480, 2, seed).astype(np.float32)
            writer.write_buffer("tap", frames, RATE, 0.01 * seed)
    return folder


@pytest.fixture
def whole(folder, tmp_path):
    """The vibration of that capture, undamaged."""
    assert call("replay", folder, tmp_path / "whole.wav").code == 0
    return vibration(tmp_path / "whole.wav")


def warned(folder, out):
    """The report and the warnings of a replay that works although something is wrong."""
    done = call("replay", folder, out, "--json")
    assert done.code == 0, done
    lines = done.stderr.splitlines()
    assert lines
    assert all(line.startswith("cushion: warning: ") for line in lines)
    return json.loads(done.stdout), "\n".join(lines)


# --- captures that are none


def test_what_is_no_capture_is_refused(tmp_path, source):
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "index.jsonl").write_text("[]\n")
    before = listing(tmp_path)
    for path, words in [
        (tmp_path / "none", "does not exist"),
        (source, "is not a folder"),
        (tmp_path / "empty", "is not a capture"),
        (tmp_path / "other", "is not a capture"),
    ]:
        assert words in refused(call("replay", path, tmp_path / "out.wav"))
        assert words in refused(call("capture", tmp_path / "new", "--tap", f"capture:{path}"))
        assert words in refused(call("dump", "--tap", f"capture:{path}"))
        assert listing(tmp_path) == before
        assert not (tmp_path / "new").exists()


def test_a_capture_without_sound_is_refused(tmp_path):
    with CaptureWriter(tmp_path / "cap"):
        pass
    error = refused(call("replay", tmp_path / "cap", tmp_path / "out.wav"))
    assert "has no sound (0 frames)" in error
    assert listing(tmp_path) == {}


# --- captures that are damaged


def test_a_capture_without_its_index_is_replayed_with_a_warning(tmp_path, folder, whole):
    (folder / "index.jsonl").unlink()
    report, warnings = warned(folder, tmp_path / "out.wav")
    assert "index.jsonl is missing or unreadable" in warnings
    assert report["frames"] == 9_600
    assert np.array_equal(vibration(tmp_path / "out.wav"), whole)


def test_a_damaged_line_of_the_index_costs_its_buffer(tmp_path, folder):
    index = folder / "index.jsonl"
    lines = index.read_bytes().splitlines(keepends=True)
    lines[5] = lines[5].replace(b'"frames":480', b'"frames":481')
    index.write_bytes(b"".join(lines))
    report, warnings = warned(folder, tmp_path / "out.wav")
    assert "damaged and left out: 1 buffer of stream tap" in warnings
    assert (report["buffers"], report["frames"]) == (19, 19 * 480)
    assert report["discontinuities"] == 1


def test_an_index_of_which_nothing_can_be_read_is_as_good_as_none(tmp_path, folder, whole):
    (folder / "index.jsonl").write_bytes(np.random.default_rng(3).bytes(3_000))
    report, warnings = warned(folder, tmp_path / "out.wav")
    assert "index.jsonl is missing or unreadable" in warnings
    assert report["frames"] == 9_600
    assert np.array_equal(vibration(tmp_path / "out.wav"), whole)


def test_samples_that_were_changed_cost_their_buffer(tmp_path, folder):
    path = folder / "tap-0001.wav"
    content = bytearray(path.read_bytes())
    content[94 + 3 * 480 * 8 + 17] ^= 0x40
    path.write_bytes(content)
    report, warnings = warned(folder, tmp_path / "out.wav")
    assert "damaged and left out: 1 buffer of stream tap" in warnings
    assert (report["buffers"], report["discontinuities"]) == (19, 1)


def test_a_segment_that_is_too_short_is_replayed_up_to_there(tmp_path, folder, whole):
    path = folder / "tap-0001.wav"
    path.write_bytes(path.read_bytes()[: 94 + 10 * 480 * 8 + 100])
    report, warnings = warned(folder, tmp_path / "out.wav")
    assert "damaged at the end: 10 buffers" in warnings
    assert report["frames"] == 4_800
    window = 2_300
    made = vibration(tmp_path / "out.wav")
    assert np.array_equal(made[: 4_800 - window], whole[: 4_800 - window])


def test_a_format_that_nobody_can_feel_is_refused_where_it_comes(tmp_path):
    with CaptureWriter(tmp_path / "cap") as writer:
        writer.write_buffer("tap", np.ones((100, 2), np.float32), RATE, 0.0)
        writer.write_buffer("tap", np.ones((100, 65), np.float32), RATE, 0.0)
    error = refused(call("replay", tmp_path / "cap", tmp_path / "out.wav"))
    assert "channels=65 is out of range" in error
    assert listing(tmp_path) == {}


# --- outputs


def test_an_output_of_a_replay_that_cannot_be_written_is_refused(tmp_path, folder):
    before = listing(folder)
    error = refused(call("replay", folder, tmp_path / "none" / "out.wav"))
    assert f"folder {tmp_path}/none does not exist" in error
    assert "is a folder" in refused(call("replay", folder, tmp_path))
    assert "name two files" in refused(call("replay", folder, folder))
    twice = [tmp_path / "out.wav", "--acceleration", tmp_path / "out.wav"]
    assert "name two files" in refused(call("replay", folder, *twice))
    assert listing(tmp_path) == {}
    assert listing(folder) == before


@pytest.mark.parametrize("name", ["tap-0001.wav", "index.jsonl"])
def test_a_replay_does_not_write_over_the_capture_that_it_reads(tmp_path, folder, name):
    before = listing(folder)
    (tmp_path / "link.wav").symlink_to(folder / name)
    for path in (folder / name, tmp_path / "link.wav"):
        assert "name two files" in refused(call("replay", folder, path))
        felt = [tmp_path / "out.wav", "--acceleration", path]
        assert "name two files" in refused(call("replay", folder, *felt))
    assert listing(folder) == before
    assert listing(tmp_path).keys() == {"link.wav"}
    assert call("replay", folder, folder / "vibration.wav").code == 0  # beside it is its own matter


@pytest.mark.parametrize("speed", ["2", "0", "fast", "", "1.0"])
def test_a_wrong_speed_is_refused(tmp_path, folder, speed):
    error = refused(call("replay", folder, tmp_path / "out.wav", "--speed", speed))
    assert f"speed='{speed}' is not known; allowed: max, 1" in error
    assert listing(tmp_path) == {}


def test_a_capture_is_made_in_a_new_or_empty_folder_only(tmp_path, source, folder):
    before = listing(folder)
    tap = ["--tap", f"file:{source}"]
    assert "not empty" in refused(call("capture", folder, *tap))
    assert listing(folder) == before
    assert "not a folder" in refused(call("capture", source, *tap))
    error = refused(call("capture", tmp_path / "none" / "cap", *tap))
    assert f"folder {tmp_path}/none does not exist" in error
    assert not (tmp_path / "none").exists()
    (tmp_path / "empty").mkdir()
    assert call("capture", tmp_path / "empty", *tap).code == 0
    error = refused(call("capture", folder, "--tap", f"capture:{folder}"))
    assert "not empty" in error


# --- taps


@pytest.mark.parametrize("tap", ["default", "sink:speakers", "app:Firefox", "speakers"])
def test_what_is_playing_cannot_be_dumped_yet_and_an_application_not_captured(tmp_path, tap):
    commands = [["dump"], ["capture", tmp_path / "cap"]]
    for command in commands if tap.startswith("app:") else commands[:1]:
        error = refused(call(*command, "--tap", tap), 3)
        assert "this command cannot capture live sound" in error
    assert not (tmp_path / "cap").exists()


@pytest.mark.exhaustive
@pytest.mark.parametrize("options", [[], ["--tap", "default"], ["--tap", "speakers"]])
def test_without_a_sound_server_nothing_that_plays_is_captured(tmp_path, options):
    env = {"PULSE_SERVER": f"unix:{tmp_path / 'none'}"}
    done = cushion("capture", tmp_path / "cap", *options, env=env)
    # 3 where libpulse is not even installed
    assert "sound server" in refused(done, 4) if done.code == 4 else refused(done, 3)
    assert not (tmp_path / "cap").exists()


@pytest.mark.parametrize(
    ("tap", "code"),
    [
        ("usb:1", 2),
        ("file:", 2),
        ("default:x", 2),
        ("", 2),
        ("scene:other", 2),
        ("file:/none.wav", 2),
        ("folder/film.wav", 2),
    ],
)
def test_a_tap_that_does_not_exist_is_refused(tmp_path, tap, code):
    for command in (["capture", tmp_path / "cap"], ["dump"]):
        refused(call(*command, "--tap", tap), code)
    assert not (tmp_path / "cap").exists()


@pytest.mark.parametrize("seconds", ["-1", "nan", "inf", "soon", ""])
def test_wrong_seconds_are_refused(tmp_path, source, seconds):
    options = ["capture", tmp_path / "cap", "--tap", f"file:{source}"]
    assert "is not a time; allowed: 0 seconds" in refused(call(*options, f"--seconds={seconds}"))
    assert "is not a time; allowed: 0 seconds" in refused(call("dump", f"--at={seconds}"))
    assert "above 0 seconds" in refused(call(*options, "--seconds=0"))
    assert not (tmp_path / "cap").exists()


# --- disks


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))


@pytest.mark.exhaustive
def test_a_capture_beyond_a_limit_on_file_sizes_can_be_replayed_up_to_there(tmp_path):
    path, folder = sound(tmp_path / "in.wav", noise(3 * RATE, 2)), tmp_path / "cap"
    done = cushion("capture", folder, "--tap", f"file:{path}", preexec_fn=limited)
    error = refused(done, 5)
    assert f"cannot write to the capture {folder}: the file would be larger than allowed" in error
    # Not even the first buffer fitted.
    assert "has no sound" in refused(call("replay", folder, tmp_path / "out.wav"))
    small = [(noise(480, 2, seed), seed) for seed in range(60)]
    with CaptureWriter(tmp_path / "small") as writer:
        for frames, seed in small:
            writer.write_buffer("tap", frames.astype(np.float32), RATE, 0.01 * seed)
    again = tmp_path / "again"
    done = cushion("capture", again, "--tap", f"capture:{tmp_path / 'small'}", preexec_fn=limited)
    refused(done, 5)
    report, warnings = warned(again, tmp_path / "out.wav")
    assert report["buffers"] == (100_000 - 94) // (480 * 8)
    assert "it was cut off" in warnings
    kept = [buffer.frames.tobytes() for buffer in Capture(again).buffers("tap")]
    assert kept == [frames.astype(np.float32).tobytes() for frames, _ in small][: len(kept)]


@pytest.mark.exhaustive
def test_a_replay_beyond_a_limit_on_file_sizes_leaves_nothing(tmp_path):
    with CaptureWriter(tmp_path / "cap") as writer:
        writer.write_buffer("tap", noise(RATE).astype(np.float32), RATE, 0.0)
    (tmp_path / "out.wav").write_bytes(b"old")
    done = cushion("replay", tmp_path / "cap", tmp_path / "out.wav", preexec_fn=limited)
    assert "the file would be larger than allowed" in refused(done, 5)
    assert listing(tmp_path) == {"out.wav": b"old"}


@pytest.fixture
def small_disk(tmp_path):
    """A filesystem of 1 MB; only root may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("a small disk can be mounted by root only: sudo make test")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.exhaustive
def test_a_full_disk_ends_a_capture_that_is_replayed_up_to_there(tmp_path, small_disk):
    done = call("capture", small_disk / "cap", "--tap", "scene:demo")
    error = refused(done, 5)
    assert "the disk is full" in error
    assert "it can be replayed up to there" in error
    report, warnings = warned(small_disk / "cap", tmp_path / "out.wav")
    assert report["buffers"] > 300
    assert "it was cut off" in warnings
    assert soundfile.info(tmp_path / "out.wav").frames == report["buffers"] * 256


def test_a_full_disk_is_a_write_error_of_a_replay(tmp_path, small_disk):
    with CaptureWriter(tmp_path / "cap") as writer:
        writer.write_buffer("tap", noise(10 * RATE).astype(np.float32), RATE, 0.0)
    error = refused(call("replay", tmp_path / "cap", small_disk / "out.wav"), 5)
    assert "the disk is full" in error
    assert listing(small_disk) == {}

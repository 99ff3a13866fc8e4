import functools
import json
import signal
import time

import numpy as np
import pytest
import soundfile

from audioflinger_hook.capture import Capture, CaptureWriter
from tests.support import commands
from tests.support.commands import RATE, call, cushion, listing, noise, refused, sound, vibration
from tests.support.signals import FORMS


def captured(folder, tap, *options):
    done = commands.call("capture", folder, "--tap", tap, *options)
    assert (done.code, done.stderr, done.stdout.count("\n")) == (0, "", 1)
    return done.stdout


replayed = functools.partial(commands.document, "replay")


def written(folder, *buffers):
    """A capture of the given buffers: (frames, samplerate, whether frames are missing before)."""
    with CaptureWriter(folder) as writer:
        for number, (frames, samplerate, missing) in enumerate(buffers):
            frames = np.asarray(frames, np.float32)
            writer.write_buffer("tap", frames, samplerate, number * 0.01, discontinuity=missing)
    return folder


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mode", ["mono", "each"])
@pytest.mark.parametrize(("samplerate", "channels"), [(44_100, 1), (48_000, 6), (44_100, 6)])
def test_a_replayed_capture_of_a_file_is_its_rendering(tmp_path, form, mode, samplerate, channels):
    source = commands.sound(tmp_path / "in.wav", commands.noise(20_000, channels), samplerate)
    options = ["--transform", form, "--channels", mode]
    captured(tmp_path / "cap", f"file:{source}")
    assert commands.call("render", source, tmp_path / "rendered.wav", *options).code == 0
    report = replayed(tmp_path / "cap", tmp_path / "replayed.wav", *options)
    rendered = (tmp_path / "rendered.wav").read_bytes()
    assert (tmp_path / "replayed.wav").read_bytes() == rendered
    assert np.abs(commands.vibration(tmp_path / "replayed.wav")).max() > 0.001
    assert report["frames"] == 20_000
    assert report["format_changes"] == report["discontinuities"] == 0


@pytest.mark.exhaustive
def test_processes_of_their_own_do_the_same_and_the_acceleration_too(tmp_path):
    source = commands.sound(tmp_path / "in.wav", commands.noise(9_600, 2))
    done = commands.cushion("capture", "cap", "--tap", "file:in.wav", cwd=tmp_path)
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout == "cap: 0.20 s in 1 buffer, 2 channels at 48000 Hz\n"
    done = commands.cushion(
        "replay", "cap", "again.wav", "--acceleration", "felt_again.wav", cwd=tmp_path
    )
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.startswith("again.wav: 0.20 s of vibration, 1 channel at 48000 Hz, peak -")
    out, felt = tmp_path / "out.wav", tmp_path / "felt.wav"
    assert commands.call("render", source, out, "--acceleration", felt).code == 0
    assert (tmp_path / "again.wav").read_bytes() == out.read_bytes()
    assert (tmp_path / "felt_again.wav").read_bytes() == felt.read_bytes()


@pytest.mark.parametrize("form", FORMS)
def test_buffers_of_any_length_are_captured_again_and_replayed_as_they_are(tmp_path, form):
    frames = commands.noise(15_000, 2).astype(np.float32)
    lengths = np.random.default_rng(0).choice([0, 1, 37, 256, 480, 2_000], 50)
    parts = np.split(frames, np.minimum(np.cumsum(lengths), len(frames)))
    buffers = [(part, commands.RATE, number == 3) for number, part in enumerate(parts)]
    written(tmp_path / "one", *buffers)
    captured(tmp_path / "two", f"capture:{tmp_path / 'one'}")
    one, two = (
        [(b.frames.tobytes(), b.format, b.discontinuity) for b in Capture(folder).buffers("tap")]
        for folder in (tmp_path / "one", tmp_path / "two")
    )
    assert one == two
    report = replayed(tmp_path / "two", tmp_path / "again.wav", "--transform", form)
    assert report["buffers"] == len(buffers)
    source = commands.sound(tmp_path / "in.wav", frames)
    assert commands.call("render", source, tmp_path / "out.wav", "--transform", form).code == 0
    assert (tmp_path / "again.wav").read_bytes() == (tmp_path / "out.wav").read_bytes()


def test_so_many_seconds_are_captured_and_no_buffer_is_cut(tmp_path):
    stated = captured(tmp_path / "cap", "scene:demo", "--seconds", 0.1)
    buffers = list(Capture(tmp_path / "cap").buffers("tap"))
    assert len(buffers) == -(-round(0.1 * commands.RATE) // 256)
    assert {len(buffer.frames) for buffer in buffers} == {256}
    assert f"0.10 s in {len(buffers)} buffers" in stated
    source = commands.sound(tmp_path / "in.wav", commands.noise(4_800))
    captured(tmp_path / "all", f"file:{source}", "--seconds", 1_000)
    assert len(next(Capture(tmp_path / "all").buffers("tap")).frames) == 4_800


def test_what_is_wrong_with_the_source_is_warned_of_and_the_rest_captured(tmp_path):
    path = commands.sound(tmp_path / "in.wav", commands.noise(5_000), subtype="PCM_16")
    path.write_bytes(path.read_bytes()[:-1_000])
    done = commands.call("capture", tmp_path / "cap", "--tap", f"file:{path}")
    assert done.code == 0
    assert done.stderr.startswith(f"cushion: warning: {path} is shorter than its header says")
    assert replayed(tmp_path / "cap", tmp_path / "out.wav")["frames"] == 4_500


def test_changes_of_format_and_discontinuities_are_replayed_and_counted(tmp_path):
    stereo, mono = commands.noise(4_800, 2), commands.noise(4_410)
    written(
        tmp_path / "cap",
        (stereo[:1_000], commands.RATE, False),
        (stereo[1_000:1_000], commands.RATE, False),
        (stereo[1_000:], commands.RATE, True),
        *[(mono[first : first + 441], 44_100, False) for first in range(0, 4_410, 441)],
        (stereo[:960], commands.RATE, True),
    )
    report = replayed(tmp_path / "cap", tmp_path / "out.wav")
    found = [report[name] for name in ("buffers", "format_changes", "discontinuities")]
    assert (found, report["samplerate"], report["channels"]) == ([14, 2, 2], commands.RATE, 1)
    assert soundfile.info(tmp_path / "out.wav").frames == report["frames"] == 2 * 4_800 + 960
    # Up to the change it is what the first format alone gives.
    source = commands.sound(tmp_path / "in.wav", np.concatenate((stereo, np.zeros((9_600, 2)))))
    assert commands.call("render", source, tmp_path / "first.wav").code == 0
    window = 2_300
    again, first = (commands.vibration(tmp_path / f"{one}.wav") for one in ("out", "first"))
    assert np.array_equal(again[: 4_800 - window], first[: 4_800 - window])
    assert np.abs(again[4_800 + window : 9_600]).max() > 0.01
    said = commands.call("replay", tmp_path / "cap", tmp_path / "out.wav").stdout
    assert said.endswith("14 buffers, 2 format changes, 2 discontinuities\n")


def test_at_speed_1_a_replay_takes_as_long_as_its_sound_and_gives_the_same_bytes(tmp_path):
    frames = commands.noise(round(0.3 * commands.RATE), 2)
    written(tmp_path / "cap", *[(part, commands.RATE, False) for part in np.split(frames, 30)])
    contents = set()
    for options in ((), ("--speed", "max"), ("--speed", "1")):
        began_s = time.monotonic()
        replayed(tmp_path / "cap", tmp_path / "out.wav", *options)
        contents.add((tmp_path / "out.wav").read_bytes())
    assert time.monotonic() - began_s >= 0.3
    assert len(contents) == 1


def buffers_there(folder):
    index = folder / "index.jsonl"
    return index.read_bytes().count(b'"kind":"buffer"') if index.exists() else 0


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_capture_is_finished_and_replays_without_warning(tmp_path, number):
    folder, silence = tmp_path / "cap", np.zeros(600 * commands.RATE, np.int16)
    # It takes a capture seconds, and next to no room.
    path = commands.sound(tmp_path / "in.flac", silence, format="FLAC", subtype="PCM_16")
    with commands.start("capture", folder, "--tap", f"file:{path}") as process:
        # The one in writing may be undone.
        commands.until(lambda: buffers_there(folder) > 1, process)
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=10)
    assert (process.returncode, stdout, stderr) == (130, "", "cushion: interrupted\n")
    assert replayed(folder, tmp_path / "out.wav")["buffers"] == buffers_there(folder)


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

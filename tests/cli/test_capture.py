import functools
import signal
import time

import numpy as np
import pytest
import soundfile

from audioflinger_hook.capture import Capture, CaptureWriter
from tests.support import commands
from tests.support.signals import FORMS


def captured(folder, tap, *options):
    """A capture that works and has nothing to warn of; returns what it says."""
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

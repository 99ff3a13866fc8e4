"""`cushion demo`: what it writes, draws and says, without waiting for the scene to be played."""

import io
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
from rich.console import Console

from audioflinger_hook.cli.demo import Meter
from audioflinger_hook.cli.terminal import level_text
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.scenes import Scene, demo_scene
from audioflinger_hook.sources import mixdown
from tests.support.commands import (
    RATE,
    call,
    cushion,
    listing,
    on_a_terminal,
    refused,
    vibration,
)

SOUNDS = {"scene.wav", "vibration.wav", "acceleration.wav"}
FRAMES = 15 * RATE

IMAGES = Path(__file__).parents[2] / "docs" / "images"
REMAKE = "make docs/images/report.png again: it is out/report.png of `cushion demo --fast`"
NUMBERS = re.compile(r"-?\d+\.\d+")
WORDS = re.compile(r"[^\d.-]+")

WITHOUT_MATPLOTLIB = """
import sys
sys.modules["matplotlib"] = None  # importing it fails, as where it is not installed
"""

ONE_SECOND = """
from audioflinger_hook.cli import demo
from audioflinger_hook.sources import mixdown
from audioflinger_hook.scenes import Scene, demo_scene
engine = demo_scene().tracks[0]
engine = type(engine)("engine", 48_000, engine.frames[:43_200], 0.1)
demo.demo_scene = lambda: Scene("one second", 48_000, (engine,), 1.0)
"""
"""A prelude: what does not depend on the scene need not wait for all of it."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """One fast demo into the default folder: (what came of it, the folder)."""
    folder = tmp_path_factory.mktemp("demo")
    done = cushion("demo", "--fast", cwd=folder)
    assert done.code == 0, done
    return done, folder / "out"


@pytest.mark.exhaustive
def test_the_demo_writes_the_sound_the_vibration_and_the_acceleration(demo):
    _, out = demo
    assert listing(out).keys() >= SOUNDS
    for name, channels in [("scene", 2), ("vibration", 1), ("acceleration", 1)]:
        info = soundfile.info(out / f"{name}.wav")
        assert (info.format, info.subtype, info.samplerate) == ("WAV", "FLOAT", RATE)
        assert (info.channels, info.frames) == (channels, FRAMES)
    with soundfile.SoundFile(out / "acceleration.wav") as file:
        assert "full scale = 100 m/s^2" in file.comment


@pytest.mark.exhaustive
def test_the_demo_draws_a_report(demo):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    done, out = demo
    assert listing(out).keys() == SOUNDS | {"report.png"}
    assert (out / "report.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert done.stderr == ""


def described(picture):
    """The text chunk that a PNG carries beside its pixels."""
    from PIL import Image

    with Image.open(picture) as image:
        return image.info["Description"]


def test_the_picture_in_the_readme_is_of_the_demo_as_it_is_now(demo):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    _, out = demo
    now, shown = (described(folder / "report.png") for folder in (out, IMAGES))
    for name in ("latency of the transform", "vibration, peak", "acceleration, peak"):
        assert f"{name}: " in now
    # The last digit may be another where another processor rounds otherwise.
    assert WORDS.findall(shown) == WORDS.findall(now), REMAKE
    for was, is_now in zip(NUMBERS.findall(shown), NUMBERS.findall(now), strict=True):
        assert float(was) == pytest.approx(float(is_now), abs=0.101), REMAKE


@pytest.mark.exhaustive
def test_the_demo_goes_the_way_that_rendering_its_sound_goes(demo, tmp_path):
    _, out = demo
    assert np.array_equal(vibration(out / "scene.wav"), mixdown(demo_scene()))
    felt = tmp_path / "acceleration.wav"
    config = tmp_path / "config.toml"
    config.write_text('[transform]\nstrength = "rig"\n')
    options = ("--profile", LIVE_DEFAULT, "--config", config, "--acceleration", felt)
    done = call("render", out / "scene.wav", tmp_path / "vibration.wav", *options)
    assert done.code == 0
    assert (tmp_path / "vibration.wav").read_bytes() == (out / "vibration.wav").read_bytes()
    assert felt.read_bytes() == (out / "acceleration.wav").read_bytes()


@pytest.mark.exhaustive
def test_every_sound_of_the_scene_is_felt_and_its_silence_is_not(demo):
    _, out = demo
    felt = vibration(out / "vibration.wav")[:, 0]
    for start_s, end_s, _ in demo_scene().events():
        assert np.abs(felt[round(start_s * RATE) : round(end_s * RATE)]).max() > 0.03
    # 9.4 to 9.7 s lies in the second of silence, away from what rings around it.
    assert np.abs(felt[round(9.4 * RATE) : round(9.7 * RATE)]).max() < 1e-3


def test_the_closing_table_says_what_is_in_the_files(demo):
    done, out = demo
    peak_db = 20 * np.log10(np.abs(vibration(out / "vibration.wav")).max())
    assert f"{peak_db:.1f} dBFS" in done.stdout
    peak_m_s2 = 100 * np.abs(vibration(out / "acceleration.wav")).max()
    assert f"{peak_m_s2:.1f} m/s²" in done.stdout
    for name in SOUNDS:
        assert f"out/{name}" in done.stdout
    for words in (
        "samples limited",
        "unusable samples in the sound",
        "time taken for 5.33 ms of sound",
        "report.png: all of it as a picture",
    ):
        assert words in done.stdout
    assert "\x1b" not in done.stdout


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A demo of one second without matplotlib: (what came of it, the folder)."""
    out = tmp_path_factory.mktemp("plain") / "out"
    return cushion("demo", "--fast", "--out", out, prelude=WITHOUT_MATPLOTLIB + ONE_SECOND), out


@pytest.mark.exhaustive
def test_without_matplotlib_the_demo_says_so_and_writes_the_rest(plain):
    done, out = plain
    assert done.code == 0
    assert done.stderr.startswith("cushion: warning: ")
    assert done.stderr.count("\n") == 1
    assert "pip install matplotlib" in done.stderr
    assert listing(out).keys() == SOUNDS


@pytest.mark.exhaustive
def test_the_meter_is_drawn_on_a_terminal_and_leaves_stdout_to_the_table(plain, tmp_path):
    options = ["demo", "--fast", "--out", tmp_path]
    prelude = WITHOUT_MATPLOTLIB + ONE_SECOND
    done, drawn = on_a_terminal(*options, prelude=prelude, streams=("stderr",))
    assert done.code == 0
    assert 10 <= drawn.count("220 Hz") <= 20  # 15 redraws a second of scene
    for label in ("sound", "vibration", "cushion", "engine", "0.9 of 1 s"):
        assert label in drawn
    meter, _, warning = drawn.rpartition("\x1b[2K")
    assert "220 Hz" in meter  # it is wiped off at the end, and the rest stands on clean ground
    assert warning.startswith("cushion: warning: no report.png")
    assert "Sound and vibration" in done.stdout
    assert "\x1b" not in done.stdout
    unwatched, out = plain
    assert "220 Hz" not in unwatched.stderr
    assert (tmp_path / "vibration.wav").read_bytes() == (out / "vibration.wav").read_bytes()


@pytest.mark.parametrize(
    ("peak", "text"),
    [(1.0, "0.0 dBFS"), (0.9999, "0.0 dBFS"), (0.5, "-6.0 dBFS"), (0.0, "silence")],
)
def test_a_level_has_no_minus_before_zero_and_silence_is_a_word(peak, text):
    assert level_text(peak) == text


class Terminal(io.StringIO):
    """A text stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_the_meter_says_silence_and_names_every_row():
    terminal = Terminal()
    screen = Console(file=terminal, force_terminal=True, width=100, color_system=None)
    block = np.full((RATE // 5, 1), 1e-4)
    with Meter(Scene("short", RATE, (), 1.0), screen) as meter:
        meter.show(RATE // 5, block, 5_000.0 * block, 10.0 * block)
    drawn = terminal.getvalue()
    sounds = [line for line in drawn.splitlines() if "sound" in line]
    assert sounds
    assert all(line.rstrip().endswith("silence") for line in sounds)
    assert "-6.0 dBFS" in drawn
    assert "felt at 20 Hz" in drawn
    assert "m/s²" in drawn


def fast_demo(folder, *, monkeypatch, seconds=0.5):
    """What a demo of a scene of silence says, inside this process and without its picture."""
    monkeypatch.setattr(
        "audioflinger_hook.cli.demo.demo_scene", lambda: Scene("short", RATE, (), seconds)
    )
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for module in [name for name in sys.modules if name.startswith("audioflinger_hook.figures")]:
        monkeypatch.delitem(sys.modules, module)
    return call("demo", "--fast", "--out", folder)


@pytest.mark.parametrize("name", ["[red]out", "[/b]", "out [x]"])
def test_a_folders_name_is_shown_as_it_is(tmp_path, monkeypatch, name):
    folder = tmp_path / name
    folder.parent.mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path)
    done = fast_demo(name, monkeypatch=monkeypatch)
    assert done.code == 0, done
    assert listing(folder).keys() == SOUNDS
    assert f"{name}/vibration.wav" in done.stdout


def test_progress_stays_away_from_a_pipe_even_where_colours_are_forced(tmp_path, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    done = fast_demo(tmp_path / "out", monkeypatch=monkeypatch)
    assert done.stderr.startswith("cushion: warning: no report.png")
    assert done.stderr.count("\n") == 1


def test_the_demo_writes_over_what_an_earlier_one_left_and_nothing_else(tmp_path, monkeypatch):
    for name in (*SOUNDS, "mine.txt"):
        (tmp_path / name).write_bytes(b"old")
    assert fast_demo(tmp_path, monkeypatch=monkeypatch).code == 0
    files = listing(tmp_path)
    assert files.keys() == SOUNDS | {"mine.txt"}
    assert files["mine.txt"] == b"old"
    assert all(files[name].startswith(b"RIFF") for name in SOUNDS)


# --- folders that will not do


def test_a_missing_parent_folder_is_refused_and_not_made(tmp_path):
    error = refused(call("demo", "--fast", "--out", tmp_path / "none" / "out"))
    assert f"{tmp_path}/none/out" in error
    assert "--out" in error
    assert listing(tmp_path) == {}
    assert not (tmp_path / "none").exists()


def test_a_file_in_the_place_of_the_folder_is_refused_and_unharmed(tmp_path):
    (tmp_path / "out").write_bytes(b"mine")
    error = refused(call("demo", "--fast", "--out", tmp_path / "out"))
    assert "is not a folder" in error
    assert listing(tmp_path) == {"out": b"mine"}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["scene.wav", "vibration.wav", "acceleration.wav", "report.png"])
def test_a_folder_in_the_place_of_a_file_is_refused_before_anything_is_written(tmp_path, name):
    (tmp_path / name).mkdir()
    error = refused(call("demo", "--fast", "--out", tmp_path))
    assert f"{name}" in error
    assert "is a folder" in error
    assert listing(tmp_path) == {}


@pytest.mark.exhaustive
def test_a_reader_of_the_table_that_has_gone_is_no_error(tmp_path):
    ours, theirs = os.pipe()
    os.close(ours)
    options = ["demo", "--fast", "--out", tmp_path]
    try:
        done = cushion(*options, prelude=WITHOUT_MATPLOTLIB + ONE_SECOND, stdout=theirs)
    finally:
        os.close(theirs)
    assert done.code == 0, done
    assert listing(tmp_path).keys() == SOUNDS

import io
import re
import signal
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
from tests.support import commands

SOUNDS = {"scene.wav", "vibration.wav", "acceleration.wav"}

IMAGES = Path(__file__).parents[2] / "docs" / "images"
REMAKE = "make docs/images/report.png again: it is out/report.png of `cushion demo --fast`"
NUMBERS = re.compile(r"-?\d+\.\d+")
WORDS = re.compile(r"[^\d.-]+")

WITHOUT_MATPLOTLIB = """
import sys
sys.modules["matplotlib"] = None  # importing it fails, as where it is not installed
"""

ONE_SECOND = """
import numpy as np
from audioflinger_hook.cli import demo
from audioflinger_hook.scenes import Scene, SceneTrack, sounds
frames = sounds.engine(48_000, np.random.default_rng(1), 0.6)[:43_200]
track = SceneTrack("engine", 48_000, frames, 0.1)
demo.demo_scene = lambda: Scene("one second", 48_000, (track,), 1.0)
"""
"""A prelude: what does not depend on the scene need not wait for all of it."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """One fast demo into the default folder: (what came of it, the folder)."""
    folder = tmp_path_factory.mktemp("demo")
    done = commands.cushion("demo", "--fast", cwd=folder)
    assert done.code == 0, done
    return done, folder / "out"


@pytest.mark.exhaustive
def test_the_demo_writes_the_sound_the_vibration_the_acceleration_and_a_report(demo):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    done, out = demo
    assert (done.stderr, {*commands.listing(out)}) == ("", SOUNDS | {"report.png"})
    for name, channels in [("scene", 2), ("vibration", 1), ("acceleration", 1)]:
        info = soundfile.info(out / f"{name}.wav")
        assert (info.format, info.subtype, info.samplerate) == ("WAV", "FLOAT", commands.RATE)
        assert (info.channels, info.frames) == (channels, 15 * commands.RATE)
    with soundfile.SoundFile(out / "acceleration.wav") as file:
        assert "full scale = 100 m/s^2" in file.comment
    assert (out / "report.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


@pytest.mark.exhaustive
def test_the_picture_in_the_readme_is_of_the_demo_as_it_is_now(demo):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    from PIL import Image

    with Image.open(demo[1] / "report.png") as picture, Image.open(IMAGES / "report.png") as kept:
        now, shown = picture.info["Description"], kept.info["Description"]
    for name in ("latency of the transform", "vibration, peak", "acceleration, peak"):
        assert f"{name}: " in now
    # The last digit may be another where another processor rounds otherwise.
    assert WORDS.findall(shown) == WORDS.findall(now), REMAKE
    for was, is_now in zip(NUMBERS.findall(shown), NUMBERS.findall(now), strict=True):
        assert float(was) == pytest.approx(float(is_now), abs=0.101), REMAKE


@pytest.mark.exhaustive
def test_the_demo_goes_the_way_that_rendering_its_sound_goes(demo, tmp_path):
    _, out = demo
    assert np.array_equal(commands.vibration(out / "scene.wav"), mixdown(demo_scene()))
    felt, config = tmp_path / "acceleration.wav", tmp_path / "config.toml"
    config.write_text('[transform]\nstrength = "rig"\n')
    options = ("--profile", LIVE_DEFAULT, "--config", config, "--acceleration", felt)
    rendered = tmp_path / "vibration.wav"
    assert commands.call("render", out / "scene.wav", rendered, *options).code == 0
    assert rendered.read_bytes() == (out / "vibration.wav").read_bytes()
    assert felt.read_bytes() == (out / "acceleration.wav").read_bytes()


@pytest.mark.exhaustive
def test_every_sound_of_the_scene_is_felt_and_its_silence_is_not(demo):
    _, out = demo
    felt = commands.vibration(out / "vibration.wav")[:, 0]
    for times in demo_scene().events():
        start, end = (round(time_s * commands.RATE) for time_s in times[:2])
        assert np.abs(felt[start:end]).max() > 0.03
    # 9.4 to 9.7 s lies in the second of silence, away from what rings around it.
    assert np.abs(felt[round(9.4 * commands.RATE) : round(9.7 * commands.RATE)]).max() < 1e-3


def test_the_closing_table_says_what_is_in_the_files(tmp_path):
    done = commands.cushion("demo", "--fast", cwd=tmp_path, prelude=ONE_SECOND)
    out = tmp_path / "out"
    peak_db = 20 * np.log10(np.abs(commands.vibration(out / "vibration.wav")).max())
    assert f"{peak_db:.1f} dBFS" in done.stdout
    peak_m_s2 = 100 * np.abs(commands.vibration(out / "acceleration.wav")).max()
    assert f"{peak_m_s2:.1f} m/s²" in done.stdout
    for name in SOUNDS:
        assert f"out/{name}" in done.stdout
    for words in (
        *("samples limited", "unusable samples in the sound", "time taken for 5.33 ms of sound"),
        "report.png: all of it as a picture",
    ):
        assert words in done.stdout
    assert "\x1b" not in done.stdout


@pytest.mark.exhaustive
def test_the_meter_is_drawn_on_a_terminal_and_leaves_stdout_to_the_table(tmp_path):
    options, prelude = ["demo", "--fast", "--out", tmp_path], WITHOUT_MATPLOTLIB + ONE_SECOND
    assert "220 Hz" not in commands.cushion(*options, prelude=prelude).stderr
    files = commands.listing(tmp_path)
    done, drawn = commands.on_a_terminal(*options, prelude=prelude, streams=("stderr",))
    assert (done.code, commands.listing(tmp_path)) == (0, files)
    assert 10 <= drawn.count("220 Hz") <= 20  # 15 redraws a second of scene
    for label in ("sound", "vibration", "cushion", "engine", "0.9 of 1 s"):
        assert label in drawn
    meter, _, warning = drawn.rpartition("\x1b[2K")
    assert "220 Hz" in meter  # it is wiped off at the end, and the rest stands on clean ground
    assert warning.startswith("cushion: warning: no report.png")
    assert "Sound and vibration" in done.stdout
    assert "\x1b" not in done.stdout


def test_a_level_has_no_minus_before_zero_and_silence_is_a_word():
    found = [level_text(peak) for peak in (1.0, 0.9999, 0.5, 0.0)]
    assert found == ["0.0 dBFS", "0.0 dBFS", "-6.0 dBFS", "silence"]


def test_the_meter_says_silence_and_names_every_row(monkeypatch):
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    screen = Console(file=terminal, force_terminal=True, width=100, color_system=None)
    block = np.full((commands.RATE // 5, 1), 1e-4)
    with Meter(Scene("short", commands.RATE, (), 1.0), screen) as meter:
        meter.show(commands.RATE // 5, block, 5_000.0 * block, 10.0 * block)
    drawn = terminal.getvalue()
    sounds = [line for line in drawn.splitlines() if "sound" in line]
    assert sounds
    assert all(line.rstrip().endswith("silence") for line in sounds)
    assert all(words in drawn for words in ("-6.0 dBFS", "felt at 20 Hz", "m/s²")), drawn


def fast_demo(folder, *, monkeypatch):
    scene = Scene("short", commands.RATE, (), 0.5)
    monkeypatch.setattr("audioflinger_hook.cli.demo.demo_scene", lambda: scene)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for module in [name for name in sys.modules if name.startswith("audioflinger_hook.figures")]:
        monkeypatch.delitem(sys.modules, module)
    return commands.call("demo", "--fast", "--out", folder)


@pytest.mark.parametrize("name", ["[red]out", "[/b]", "out [x]"])
def test_a_folders_name_is_shown_as_it_is(tmp_path, monkeypatch, name):
    folder = tmp_path / name
    folder.parent.mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FORCE_COLOR", "1")  # on a pipe nothing is drawn even so
    done = fast_demo(name, monkeypatch=monkeypatch)
    assert done.code == 0, done
    assert commands.listing(folder).keys() == SOUNDS
    assert f"{name}/vibration.wav" in re.sub(r"\x1b\[[\d;]*m", "", done.stdout)
    assert done.stderr.startswith("cushion: warning: no report.png")
    assert "pip install matplotlib" in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_demo_writes_over_what_an_earlier_one_left_and_nothing_else(tmp_path, monkeypatch):
    for name in (*SOUNDS, "mine.txt"):
        (tmp_path / name).write_bytes(b"old")
    assert fast_demo(tmp_path, monkeypatch=monkeypatch).code == 0
    files = commands.listing(tmp_path)
    assert ({*files}, files["mine.txt"]) == (SOUNDS | {"mine.txt"}, b"old")
    assert all(files[name].startswith(b"RIFF") for name in SOUNDS)


def test_a_place_where_the_files_cannot_be_is_refused_and_nothing_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"mine")
    for place, words in (("none/out", "--out"), ("file", "is not a folder")):
        error = commands.refused(fast_demo(tmp_path / place, monkeypatch=monkeypatch))
        assert f"{tmp_path}/{place}" in error
        assert words in error
    assert commands.listing(tmp_path) == {"file": b"mine"}
    assert not (tmp_path / "none").exists()
    for name in (*SOUNDS, "report.png"):
        folder = tmp_path / f"with {name}"
        (folder / name).mkdir(parents=True)
        error = commands.refused(fast_demo(folder, monkeypatch=monkeypatch))
        assert f"{name}" in error
        assert "is a folder" in error
        assert commands.listing(folder) == {}


@pytest.mark.exhaustive
def test_a_reader_of_the_table_that_has_gone_is_no_error(tmp_path):
    prelude = WITHOUT_MATPLOTLIB + ONE_SECOND
    done = commands.without_a_reader("demo", "--fast", "--out", tmp_path, prelude=prelude)
    assert done.code == 0, done
    assert commands.listing(tmp_path).keys() == SOUNDS


@pytest.mark.exhaustive
def test_an_interrupted_demo_leaves_nothing(tmp_path):
    out = tmp_path / "out"
    with commands.start("demo", "--out", out) as process:
        # The whole sound and half a second of vibration: in the middle of what lasts 15 s.
        half = 4 * commands.RATE // 2
        commands.until(lambda: sum(n > half for n in commands.held_back(process, out)) > 1, process)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=10)
    assert (process.returncode, stdout, stderr) == (130, "", "cushion: interrupted\n")
    assert not commands.listing(out)

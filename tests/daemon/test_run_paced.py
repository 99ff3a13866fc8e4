"""`cushion run` without a sound server: files, captures and the scene into a file or the twin."""

import json
import math
import resource
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.capture import Capture, CaptureWriter
from audioflinger_hook.config.profiles import LIVE_DEFAULT, parameters_of
from audioflinger_hook.daemon.recording import settings_from
from device.drive.outputs import FADE_S
from device.units import Float32Array
from tests.daemon.test_run_recording import overlap, recorded, same_again
from tests.support import commands
from tests.support.commands import RATE, call, cushion, listing, noise, refused, sound, start, until
from tests.support.data import table

NO_SERVER = """
import sys
sys.modules["pulsectl"] = sys.modules["pyaudio"] = None
"""
"""Neither library can be loaded: nothing can ask a sound server for anything."""

BEFORE_S = 3.0  # more than the silence before and behind the vibration in a file


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "run").mkdir(mode=0o700)
    return {"XDG_RUNTIME_DIR": str(tmp_path / "run"), "XDG_CONFIG_HOME": str(tmp_path / "config")}


def run(env: dict[str, str], *arguments: object, **options: object) -> commands.Done:
    return cushion("run", *arguments, prelude=NO_SERVER, env=env, **options)


def status(env: dict[str, str]) -> dict[str, Any]:
    done = cushion("status", "--json", env=env)
    return json.loads(done.stdout) if done.code == 0 else {}


def aligned(whole: Float32Array, wanted: Float32Array) -> Float32Array:
    """The part of a recording that is most like `wanted`, of its length or up to the end."""
    size = len(whole) + len(wanted)
    spectrum = np.fft.rfft(whole[:, 0], size) * np.fft.rfft(wanted[:, 0], size).conj()
    return whole[int(np.argmax(np.fft.irfft(spectrum, size)[: len(whole)])) :][: len(wanted)]


def rendered(source: Path, out: Path) -> commands.Done:
    return call("render", source, out, "--profile", LIVE_DEFAULT)


def error_db(got: Float32Array, wanted: Float32Array) -> float:
    ratio = float(np.sum(np.square(got - wanted)) / np.sum(np.square(wanted)))
    return 10.0 * math.log10(ratio) if ratio else -math.inf  # nothing differs


def told(stderr: str) -> list[str]:
    """What it says of itself, but for the first line and what a busy machine adds."""
    lines = [line.removeprefix("cushion: ") for line in stderr.splitlines()]
    assert lines[0].startswith("sound of ")
    return [line for line in lines[1:] if not line.startswith(("resync: ", "stall: "))]


def test_a_file_ends_by_itself_when_its_vibration_has_run_out(tmp_path, folder):
    source = sound(tmp_path / "in.wav", noise(44_100, 2), 44_100)
    assert rendered(source, tmp_path / "wanted.wav").code == 0
    out, record = tmp_path / "out.wav", tmp_path / "rec"
    done = run(folder, "--tap", f"file:{source}", "--device", f"wav:{out}", "--record", record)
    assert (done.code, told(done.stderr)) == (0, ["running"])
    felt, wanted = commands.vibration(out), commands.vibration(tmp_path / "wanted.wav")
    assert np.array_equal(recorded(record, "device"), felt)
    facts = Capture(record).facts
    assert (facts["tap"], facts["device"]) == (f"file:{source}", f"wav:{out}")
    assert (Capture(record).warnings, len(aligned(felt, wanted))) == ([], len(wanted))
    # the delay line may stand between two frames: half of one is 0.8 degrees of 200 Hz
    whole = slice(0, -round(FADE_S * 44_100))  # a rendered file ends with a fade
    assert error_db(aligned(felt, wanted)[whole], wanted[whole]) < -40.0
    assert np.abs(wanted[-1_000:]).max() > 0.0
    assert not felt[-1_000:].any()
    assert soundfile.info(out).samplerate == 44_100


@pytest.mark.parametrize(
    ("text", "options", "profile", "said"),
    [
        ("", (), "cinema", ()),
        ("[transform]\npartials_max = 5\n", (), "cinema", ("partials_max",)),
        ('profile = "game"\n', (), "game", ()),
        ('profile = "game"\n', ("--profile", "paper"), "paper", ()),
    ],
    ids=["nothing named", "a parameter", "the config's", "the option's"],
)
def test_the_profile_is_cinema_unless_named_and_a_replay_needs_no_name(
    tmp_path, folder, text, options, profile, said
):
    source, record = sound(tmp_path / "in.wav", noise(RATE // 4)), tmp_path / "rec"
    (tmp_path / "c.toml").write_text(text)
    named = ("--config", tmp_path / "c.toml", *options) if text else options
    places = ("--tap", f"file:{source}", "--device", "twin", "--record", record)
    assert run(folder, *places, *named).code == 0
    settings: Any = settings_from(Capture(record).facts)
    assert (settings.profile, settings.said) == (profile, said)
    assert settings.parameters == parameters_of(profile, dict.fromkeys(said, 5))
    assert same_again(record, tmp_path / "out.wav") > RATE // 8


@pytest.mark.exhaustive
@pytest.mark.parametrize("transform", ["live", "reference"])
def test_what_was_recorded_of_a_capture_of_many_formats_comes_again(tmp_path, folder, transform):
    (tmp_path / "c.toml").write_text(
        f'[transform]\ntransform = "{transform}"\nchannels = "each"\nwindow_s = 0.06\n'
    )
    buffers = [(480, 2, 48_000), (256, 1, 44_100), (1, 2, 96_000), (3_000, 2, 48_000)]
    with CaptureWriter(tmp_path / "in") as writer:
        for number in range(60):
            frames, channels, samplerate = buffers[number // 10 % 4]
            content = noise(frames, channels, number).astype(np.float32)
            gap = number % 25 == 24
            writer.write_buffer("tap", content, samplerate, number * 1.0, discontinuity=gap)
    record, config = ["--record", tmp_path / "rec"], ["--config", tmp_path / "c.toml"]
    done = run(folder, "--tap", f"capture:{tmp_path / 'in'}", "--device", "twin", *record, *config)
    assert (done.code, told(done.stderr)) == (0, ["running"])
    assert done.stdout.startswith("twin (predicted): peak acceleration ")
    one, two = (list(Capture(tmp_path / name).buffers("tap")) for name in ("in", "rec"))
    assert [(b.frames.tobytes(), b.format, b.discontinuity) for b in one] == [
        (b.frames.tobytes(), b.format, b.discontinuity) for b in two
    ]
    common = same_again(tmp_path / "rec", tmp_path / "out.wav")
    assert commands.vibration(tmp_path / "out.wav").shape == (common, 2)


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_leaves_whole_files(tmp_path, folder, number):
    out, record = tmp_path / "out.wav", tmp_path / "rec"
    out.write_bytes(b"old")
    options = ["--tap", "scene:demo", "--device", f"wav:{out}", "--record", record]
    with start("run", *options, prelude=NO_SERVER, env=folder) as process:
        effect = record / "effect-0001.wav"
        until(lambda: effect.exists() and effect.stat().st_size > 3 * RATE, process)
        assert out.read_bytes() == b"old"
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=20)
    assert (process.returncode, stdout, told(stderr)) == (130, "", ["running", "interrupted"])
    assert np.array_equal(recorded(record, "device"), commands.vibration(out))
    assert same_again(record, tmp_path / "again.wav") > RATE // 2


@pytest.mark.exhaustive
def test_a_killed_run_leaves_no_file_and_a_recording_up_to_there(tmp_path, folder):
    out, record = tmp_path / "out.wav", tmp_path / "rec"
    options = ["--tap", "scene:demo", "--device", f"wav:{out}", "--record", record]
    with start("run", *options, prelude=NO_SERVER, env=folder) as process:
        effect = record / "effect-0001.wav"
        until(lambda: effect.exists() and effect.stat().st_size > 4 * RATE, process)
        process.kill()
    assert not out.exists()
    done = call("replay", record, tmp_path / "again.wav", "--json")
    assert done.code == 0
    assert "it was cut off" in done.stderr
    assert 0 <= len(recorded(record, "tap")) - len(recorded(record, "effect")) <= 4 * 1_024
    assert overlap(record, tmp_path / "again.wav", done.stdout) > RATE // 2


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))


@pytest.mark.exhaustive
def test_a_full_disk_ends_the_recording_with_one_warning_and_the_run_goes_on(tmp_path, folder):
    source, record = sound(tmp_path / "in.wav", noise(2 * RATE, 2)), tmp_path / "rec"
    options = ["--tap", f"file:{source}", "--device", "twin", "--record", record]
    done = run(folder, *options, preexec_fn=limited)
    assert done.code == 5
    assert done.stdout.startswith("twin (predicted)")  # it came to its end
    said = told(done.stderr)
    assert (len(said), said[0]) == (3, "running")
    assert said[1].startswith("warning: the recording has ended: cannot write to")
    assert said[2].startswith("error: cannot write to the capture")


@pytest.mark.exhaustive
def test_a_full_disk_is_the_end_of_a_file_and_of_the_run(tmp_path, folder):
    out = tmp_path / "out.wav"
    out.write_bytes(b"old")
    done = run(folder, "--tap", "scene:demo", "--device", f"wav:{out}", preexec_fn=limited)
    assert done.code == 5
    assert "the file would be larger than allowed" in done.stderr.splitlines()[-1]
    assert out.read_bytes() == b"old"


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("tap", "device", "options", "code", "words"),
    table("refused-runs.toml")["refused"],
)
def test_what_cannot_be_is_refused_and_nothing_is_touched(
    tmp_path, folder, monkeypatch, tap, device, options, code, words
):
    sound(tmp_path / "in.wav", noise(480))
    (tmp_path / "names.toml").write_text('[[actuator]]\nchannels = ["front-left"]\n')
    with CaptureWriter(tmp_path / "cap") as writer:
        writer.write_buffer("tap", noise(480).astype(np.float32), RATE, 0.0)
    before = listing(tmp_path), listing(tmp_path / "cap")
    for name, value in folder.items():
        monkeypatch.setenv(name, value)
    texts = [text.format(tmp_path) for text in (tap, device, *options)]
    assert words in refused(call("run", "--tap", texts[0], "--device", texts[1], *texts[2:]), code)
    assert (listing(tmp_path), listing(tmp_path / "cap")) == before


@pytest.mark.exhaustive
def test_while_a_file_plays_its_level_may_change_and_what_begins_anew_may_not(tmp_path, folder):
    config, new = tmp_path / "c.toml", tmp_path / "new.toml"
    source, out = sound(tmp_path / "in.wav", noise(20 * RATE, 2)), tmp_path / "out.wav"
    config.write_text(f'tap = "file:{source}"\ndevice = "wav:{out}"\n')

    def reload(process, text, answer):
        new.write_text(config.read_text() + text)
        new.replace(config)
        process.send_signal(signal.SIGHUP)
        for line in process.stderr:
            if line.startswith("cushion: resync"):
                continue
            assert answer in line
            return

    with start("run", "--config", config, prelude=NO_SERVER, env=folder) as process:
        try:
            assert process.stderr is not None
            for line in process.stderr:
                if line == "cushion: running\n":
                    break
            reload(process, "gain_db = -6\n", "config reloaded; changed: the level")
            reload(process, 'tap = "default"\n', "is not TOML")  # twice in one file
            config.write_text(f'tap = "default"\ndevice = "wav:{out}"\n')
            reload(process, "", f"the tap 'file:{source}' cannot become 'default'")
            config.write_text(f'tap = "file:{source}"\ndevice = "wav:{out}"\ngain_db = -6\n')
            reload(process, "", "changed: nothing")
            reload(process, '[transform]\nchannels = "each"\n', "cannot change while 'file:")
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=20)
        finally:
            process.kill()
    assert process.returncode == 130
    assert len(commands.vibration(out)) > 0


COUNTED = """
import atexit, gc, sys
atexit.register(lambda: print(gc.get_freeze_count(), len(gc.get_objects()), file=sys.stderr))
"""


@pytest.mark.exhaustive
def test_a_run_lasts_as_long_as_told_and_its_collection_looks_at_few_objects(tmp_path, folder):
    options = ("--tap", "scene:demo", "--device", f"wav:{tmp_path}/a.wav", "--seconds", 1)
    done = cushion("run", *options, prelude=COUNTED, env=folder)
    assert done.code == 0, done.stderr
    spared, looked_at = map(int, done.stderr.splitlines()[-1].split())
    assert spared > 20_000
    assert looked_at < 0.1 * spared  # then it takes some ms at most
    assert 1.0 < len(commands.vibration(tmp_path / "a.wav")) / RATE < 1.0 + BEFORE_S


THREE = """\
actuator = [
    { source = "left", channels = [3] },
    { source = "left", channels = [2], delay_ms = 15 },
    { source = "right", channels = [0], gain_db = -6, polarity = "inverted", RIG },
]
""".replace("RIG", 'rig = "consumer", protection = "on"')


def tones(seconds: float) -> np.ndarray:
    times = np.arange(round(seconds * RATE)) / RATE
    return np.column_stack([0.4 * np.sin(2.0 * np.pi * hz * times) for hz in (110.0, 400.0)])


@pytest.mark.exhaustive
def test_status_tells_of_each_and_a_reload_reaches_them_without_a_gap(tmp_path, folder):
    config, out = tmp_path / "c.toml", tmp_path / "out.wav"
    config.write_text(THREE)
    source = sound(tmp_path / "in.wav", tones(60.0))
    options = ["--tap", f"file:{source}", "--device", f"wav:{out}", "--config", config]
    with start("run", *options, prelude=NO_SERVER, env=folder) as process:

        def plays() -> bool:
            told = status(folder).get("actuators", [])
            return bool(told) and told[0]["level"]["peak_dbfs"] > -40.0

        until(plays, process)
        before = status(folder)
        config.write_text(THREE.replace("-6", "-46").replace("delay_ms = 15", "delay_ms = 115"))
        process.send_signal(signal.SIGHUP)
        until(lambda: status(folder)["actuators"][2]["gain_db"] == -46.0, process)
        changed_s = time.monotonic()
        until(lambda: time.monotonic() - changed_s > 0.5, process)
        after = status(folder)
        config.write_text(THREE.replace("[2]", "[7]"))
        process.send_signal(signal.SIGHUP)
        until(lambda: any("restart the daemon" in w for w in status(folder)["warnings"]), process)
        assert status(folder)["actuators"][1]["channels"] == ["2"]
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=20)
    assert "changed: the actuators" in stderr
    assert "Traceback" not in stderr
    assert before["tap"] == {"address": f"file:{source}", "name": f"file:{source}"}
    assert before["device"]["address"] == f"wav:{out}"
    _, left, right = before["actuators"]
    assert (left["source"], left["channels"], left["rig"]) == ("left", ["2"], "paper")
    assert (right["gain_db"], right["polarity"], right["delay_ms"]) == (-6.0, "inverted", 0.0)
    assert left["protection"] is left["exposure"] is None
    assert right["protection"]["least_gain"] == 1.0
    assert right["protection"]["coil_c"] >= 25.0  # the consumer's living room
    assert right["exposure"]["above_action"] is False
    # Of one rig's worth of protection the figures of before are that one's.
    assert before["protection"].keys() == right["protection"].keys()
    assert before["latency"]["driving_ms"] == 4.0
    assert (before["latency"]["delay_ms"], after["latency"]["delay_ms"]) == (15.0, 115.0)
    felt = commands.vibration(out)
    assert not felt[:, 1].any()
    blocks = np.abs(felt[: len(felt) // 480 * 480]).reshape(-1, 480, 4).max(axis=1)
    sounding = np.flatnonzero(blocks[:, 2] > 0.1 * blocks[:, 2].max())
    # No gap in 10 ms of the one whose delay was another.
    assert (blocks[sounding[0] : sounding[-1], 2] > 0.05 * blocks[:, 2].max()).all()
    assert blocks[-100:-20, 0].max() < 0.02 * blocks[:, 0].max()

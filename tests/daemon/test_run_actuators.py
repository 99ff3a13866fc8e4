"""`cushion run` with several actuators, without a sound server: into a file and simulated rigs."""

from __future__ import annotations

import json
import re
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.profiles import LIVE_DEFAULT
from device.drive.outputs import FADE_S
from tests.daemon.test_run_paced import NO_SERVER, aligned, error_db, folder, run
from tests.support.commands import (
    RATE,
    Done,
    call,
    cushion,
    refused,
    sound,
    start,
    until,
    vibration,
)

__all__ = ["folder"]

THREE = """\
[[actuator]]
source = "left"
channels = [3]

[[actuator]]
source = "left"
channels = [2]
delay_ms = 15

[[actuator]]
source = "right"
channels = [0]
gain_db = -6
polarity = "inverted"
"""


def tones(seconds: float) -> np.ndarray:
    times = np.arange(round(seconds * RATE)) / RATE
    waves = [0.4 * np.sin(2.0 * np.pi * hz * times) for hz in (110.0, 400.0)]
    return np.column_stack(waves)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return sound(tmp_path / "in.wav", tones(1.5))


@pytest.mark.exhaustive
def test_a_file_gets_what_the_same_config_renders(tmp_path, folder, source):
    (tmp_path / "c.toml").write_text(THREE)
    options = ("--config", tmp_path / "c.toml", "--profile", LIVE_DEFAULT)
    assert call("render", source, tmp_path / "wanted.wav", *options).code == 0
    out = tmp_path / "out.wav"
    done = run(folder, "--tap", f"file:{source}", "--device", f"wav:{out}", *options)
    assert done.code == 0
    felt, wanted = vibration(out), vibration(tmp_path / "wanted.wav")
    assert felt.shape[1] == wanted.shape[1] == 4
    assert not felt[:, 1].any()
    part = aligned(felt, wanted)
    assert len(part) == len(wanted)
    # the delay line may stand between two frames: half of one is 0.8 degrees of 200 Hz
    unfaded = slice(-round(FADE_S * RATE))  # a run does not fade its end, a rendered file does
    assert error_db(part[unfaded], wanted[unfaded]) < -30.0
    # what the delay carries past the end is played
    assert np.abs(felt[-RATE:, 2]).max() > 0.0


@pytest.mark.exhaustive
def test_simulated_rigs_say_what_the_worst_of_them_did(tmp_path, folder, source):
    (tmp_path / "c.toml").write_text(THREE + 'rig = "consumer"\n')
    options = ("--config", tmp_path / "c.toml")
    done = run(folder, "--tap", f"file:{source}", "--device", "twin", *options)
    assert done.code == 0
    assert done.stdout.startswith("twin (predicted): peak acceleration ")


@pytest.mark.exhaustive
def test_status_tells_of_each_and_a_reload_reaches_them_without_a_gap(tmp_path, folder):
    config, out = tmp_path / "c.toml", tmp_path / "out.wav"
    config.write_text(THREE + 'protection = "on"\n')
    source = sound(tmp_path / "in.wav", tones(60.0))
    options = ["--tap", f"file:{source}", "--device", f"wav:{out}", "--config", config]
    with start("run", *options, prelude=NO_SERVER, env=folder) as process:
        said: list[Done] = []

        def status() -> dict[str, Any]:
            said[:] = [cushion("status", "--json", env=folder)]
            return json.loads(said[0].stdout) if said[0].code == 0 else {}

        def plays(number: int, above_dbfs: float) -> bool:
            told = status().get("actuators", [])
            return bool(told) and told[number]["level"]["peak_dbfs"] > above_dbfs

        until(lambda: plays(0, -40.0), process)
        before = status()
        config.write_text(
            THREE.replace("-6", "-46").replace("delay_ms = 15", "delay_ms = 115")
            + 'protection = "on"\n'
        )
        process.send_signal(signal.SIGHUP)
        until(lambda: status()["actuators"][2]["gain_db"] == -46.0, process)
        changed_s = time.monotonic()
        until(lambda: time.monotonic() - changed_s > 0.5, process)
        after = status()
        config.write_text(THREE.replace("[2]", "[7]") + 'protection = "on"\n')
        process.send_signal(signal.SIGHUP)
        until(lambda: any("restart the daemon" in w for w in status()["warnings"]), process)
        assert status()["actuators"][1]["channels"] == ["2"]
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=20)
    assert "changed: the actuators" in stderr
    assert "Traceback" not in stderr
    _, left, right = before["actuators"]
    assert (left["source"], left["channels"], left["rig"]) == ("left", ["2"], "paper")
    assert (right["gain_db"], right["polarity"], right["delay_ms"]) == (-6.0, "inverted", 0.0)
    assert left["protection"] is left["exposure"] is None
    assert right["protection"]["least_gain"] == 1.0
    assert right["exposure"]["above_action"] is False
    # Of one rig's worth of protection the figures of before are that one's.
    assert before["protection"].keys() == right["protection"].keys()
    assert before["latency"]["driving_ms"] == 4.0
    assert (before["latency"]["delay_ms"], after["latency"]["delay_ms"]) == (15.0, 115.0)
    felt = vibration(out)
    blocks = np.abs(felt[: len(felt) // 480 * 480]).reshape(-1, 480, 4).max(axis=1)
    sounding = np.flatnonzero(blocks[:, 2] > 0.1 * blocks[:, 2].max())
    # No gap in 10 ms of the one whose delay was another.
    assert (blocks[sounding[0] : sounding[-1], 2] > 0.05 * blocks[:, 2].max()).all()
    assert blocks[-100:-20, 0].max() < 0.02 * blocks[:, 0].max()


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("twin", "channel front-left.*numbers only"),
        ("wav:{}/out.wav", "channel front-left.*numbers only"),
        ("hw:0", "channel front-left.*numbers only"),
    ],
)
def test_names_are_refused_where_channels_have_none(tmp_path, folder, device, words):
    (tmp_path / "c.toml").write_text('[[actuator]]\nchannels = ["front-left"]\n')
    device = device.format(tmp_path)
    options = ("--config", tmp_path / "c.toml", "--device", device)
    done = run(folder, "--tap", "scene:demo", *options)
    assert re.search(words, refused(done))
    assert not (tmp_path / "out.wav").exists()

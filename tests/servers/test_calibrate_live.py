"""`cushion calibrate` on a sound server: a simulated cushion hangs on its sinks."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from device.identification.mechanics import format_rig
from device.rig import PAPER, read_rig
from tests.servers.conftest import started
from tests.servers.cushion_on_a_bench import MAP, NAMES, OPTIONS
from tests.servers.daemons import CUSHION, cushion, environment, felt_now, program
from tests.servers.listening import RATE_HZ, recording, wait_for
from tests.support.commands import refused
from tools.sound_server import SoundServer

BENCH = "tests.servers.cushion_on_a_bench"


@pytest.fixture
def server(monkeypatch):
    """PulseAudio alone: each sweep takes its time, and streams are the same on both."""
    for server in started("pulse", monkeypatch):
        server.add_sink("instruments", channel_map=MAP)
        yield server


@contextmanager
def on_a_bench(server: SoundServer, rig: str = "paper") -> Iterator[None]:
    command = (sys.executable, "-m", BENCH, "haptic", "instruments", rig)
    with program(environment(server), *command, start_new_session=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield
        finally:
            os.killpg(process.pid, signal.SIGKILL)  # with its players


def arguments(out: Path) -> list[str]:
    return [
        *("calibrate", "--device", "sink:haptic", "--input", "source:instruments.monitor"),
        *("--channels", NAMES, *OPTIONS, "--out", str(out)),
    ]


@pytest.mark.calm
def test_a_coil_with_eddy_currents_is_identified_and_its_file_is_used_at_once(server, tmp_path):
    coil = {"inductance_h": 5e-4, "inductance_eddy_h": 1.5e-3, "resistance_eddy_ohm": 1.5}
    eddy = replace(PAPER.actuator, **coil)
    amplifier = replace(PAPER.amplifier, gain=5.0, low_cut_hz=3.0)
    true = replace(PAPER, name="true", actuator=eddy, amplifier=amplifier, sources=())
    (tmp_path / "true.toml").write_text(format_rig(true))
    path = tmp_path / "mine.toml"
    with on_a_bench(server, str(tmp_path / "true.toml")):
        done = cushion(server, *arguments(path), "--seconds", "2", "--level", "0.02", "--json")
    assert done.code == 0, done.stderr
    found = read_rig(path)
    assert found.name == "mine"
    for name in ("resistance_ohm", "force_factor_n_per_a", "moving_mass_kg"):
        assert getattr(found.actuator, name) == pytest.approx(getattr(eddy, name), rel=0.02)
    assert found.amplifier.gain == pytest.approx(5.0, rel=0.01)
    assert found.amplifier.low_cut_hz == pytest.approx(3.0, rel=0.05)
    for name, one in json.loads(done.stdout)["values"].items():
        stage, field = name.split(".")
        value, (low, high) = getattr(getattr(true, stage), field), one["interval"]
        # volts are straight lines between samples on this bench, which moves L and R2 by 0.07 %
        assert low - 1e-3 * value <= value <= high + 1e-3 * value, name


def test_where_nothing_hangs_on_it_there_is_no_signal_and_no_file(server, tmp_path):
    path = tmp_path / "mine.toml"
    assert "no signal" in refused(cushion(server, *arguments(path), "--seconds", "0.5"))
    assert not path.exists()


@pytest.mark.calm
def test_ctrl_c_in_a_sweep_is_silence_at_once_and_no_file(server, tmp_path):
    path = tmp_path / "mine.toml"
    command = (*CUSHION, *arguments(path), "--seconds", "30")
    with (
        on_a_bench(server),
        recording(server, "haptic.monitor", tmp_path / "heard") as heard,
        program(environment(server), *command, stderr=subprocess.PIPE) as process,
    ):
        wait_for(lambda: felt_now(heard) or process.poll() is not None, "the sweep", 30.0)
        assert process.poll() is None, process.communicate()
        process.send_signal(signal.SIGINT)
        pressed = len(heard())
        _, stderr = process.communicate(timeout=15.0)
        wait_for(lambda: len(heard()) > pressed + RATE_HZ // 2, "what followed")
        frames = heard()
    assert process.returncode == 130
    assert "Traceback" not in stderr
    # what had been handed to the server, and the time until a signal is looked at
    assert not frames[pressed + int(0.25 * RATE_HZ) :].any()
    assert not path.exists()

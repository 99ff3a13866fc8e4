"""Faults of sinks while `cushion run` plays: each ends in recovery, with the time that it took."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.state import DaemonState
from tests.servers.daemons import CUSHION, FELT, ROOT, environment, felt_now, running, tone
from tests.servers.listening import playing, recording, wait_for
from tools.sound_server import SoundServer

pytestmark = pytest.mark.calm

BACK_S = 2.0
"""Within this it plays again once the fault is over."""


def test_the_tapped_sink_is_removed_and_added_again(server: SoundServer, tmp_path: Path) -> None:
    server.add_sink("speakers")
    with (
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
        running(server, "--tap", "sink:speakers") as daemon,
    ):
        with playing(server, "speakers", tone(60.0, 60.0)):
            wait_for(lambda: felt_now(felt), "vibration")
            server.remove("speakers")
            status = daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        assert "no sink 'speakers'" in status.reason
        wait_for(lambda: not felt_now(felt), "silence")
        server.add_sink("speakers")
        with playing(server, "speakers", tone(60.0, 60.0)):
            back_s = time.monotonic()
            wait_for(lambda: felt_now(felt), "vibration again", 10.0)
            took_s = time.monotonic() - back_s
            daemon.wait_state(DaemonState.RUNNING)
    print(f"{server.kind}: felt {took_s:.2f} s after the tapped sink played again")
    assert took_s < BACK_S


def test_the_default_sink_is_removed_and_what_takes_its_place_is_felt(
    server: SoundServer, tmp_path: Path
) -> None:
    server.add_sink("speakers")
    server.choose_default("speakers")
    with (
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
        running(server) as daemon,
        # PulseAudio moves the player with its sink's end, PipeWire plays to the new default
        playing(server, "desktop", tone(60.0, 60.0)),
    ):
        daemon.wait(lambda s: s.tap.name == "speakers.monitor", "the tap")
        assert not felt_now(felt)
        gone_s = time.monotonic()
        server.remove("speakers")
        server.choose_default("desktop")  # a server may choose the device, which is never tapped
        wait_for(lambda: felt_now(felt), "vibration", 10.0)
        took_s = time.monotonic() - gone_s
        daemon.wait(lambda s: s.tap.name == "desktop.monitor", "the new tap")
    print(f"{server.kind}: felt {took_s:.2f} s after the default sink was removed")
    assert took_s < BACK_S


@pytest.mark.parametrize("sink", ["haptic", "desktop"])
def test_a_suspended_sink_stops_the_vibration_and_it_goes_on_afterwards(
    server: SoundServer, sink: str, tmp_path: Path
) -> None:
    if server.kind == "pipewire":
        pytest.skip("PipeWire resumes a sink that is played to")
    with (
        playing(server, "desktop", tone(60.0, 60.0)),
        running(server) as daemon,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        server.pactl("suspend-sink", sink, "1")
        frames = len(felt())
        suspended_s = time.monotonic()
        wait_for(lambda: time.monotonic() - suspended_s > 3.0, "three seconds")
        if sink == "desktop":
            assert not felt_now(felt)
        else:
            assert len(felt()) - frames < 24_000  # its monitor stood, too
        resumed = len(felt())
        server.pactl("suspend-sink", sink, "0")
        back_s = time.monotonic()
        wait_for(lambda: np.abs(felt()[resumed:]).max(initial=0.0) > FELT, "vibration", 10.0)
        took_s = time.monotonic() - back_s
        daemon.wait_state(DaemonState.RUNNING)
        wait_for(lambda: felt_now(felt), "vibration that goes on")
        loudest = float(np.abs(felt()[resumed:]).max())
    print(f"{server.kind}: felt {took_s:.2f} s after {sink} was resumed, at most {loudest:.2f}")
    assert took_s < BACK_S
    assert loudest <= 1.0


def test_a_test_tone_whose_device_vanishes_ends_and_says_so(server: SoundServer) -> None:
    command = [*CUSHION, "test-tone", "--device", "haptic", "--seconds", "20"]
    with subprocess.Popen(
        command,
        env=environment(server),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert "60 Hz" in process.stdout.readline()
        server.remove("haptic")
        assert process.wait(10.0) == 4
        assert "the device was lost" in process.stderr.read()


def test_a_killed_daemon_leaves_its_dose_and_a_damaged_record_means_hot_coils(
    server: SoundServer,
) -> None:
    record = Path(server.environment["XDG_STATE_HOME"]) / "cushion" / "actuators.json"
    protected = "--protection", "on"
    with playing(server, "desktop", tone(60.0, 60.0)):
        with running(server, *protected) as daemon:
            seen = daemon.wait(lambda status: status.exposure and status.exposure.a8_m_s2, "a dose")
            assert seen.protection
            assert seen.protection.coil_c == pytest.approx(20.0, abs=1.0)
            assert not seen.warnings
            wait_for(record.exists, "the record")
            daemon.process.kill()
        left = json.loads(record.read_text())["actuators"]["haptic 0.0"]["dose"]["squares"]
        with running(server, *protected) as daemon:
            seen = daemon.wait(lambda status: status.exposure, "the dose")
            assert seen.exposure
            assert seen.exposure.a8_m_s2 >= (left / 28_800.0) ** 0.5
            assert not any("coils count" in warning for warning in seen.warnings)
        record.write_text("{")
        with running(server, *protected) as daemon:
            seen = daemon.wait(lambda status: status.protection, "protection")
            assert seen.protection
            assert seen.protection.coil_c is not None
            assert seen.protection.coil_c > 90.0
            assert sum("damaged" in warning for warning in seen.warnings) == 1

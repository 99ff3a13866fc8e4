"""What `cushion run` listens to: the default sink and nothing else, wherever that goes."""

from __future__ import annotations

import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.state import Cause, DaemonState
from device.stream.pcms import TAG
from tests.servers.daemons import felt_hz, felt_now, pitch_hz, recovered, running, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tools.sound_server import ServerError, SoundServer

HERE_HZ, THERE_HZ = 110.0, 400.0
HERE_FELT_HZ, THERE_FELT_HZ = felt_hz(HERE_HZ), felt_hz(THERE_HZ)
"""The vibration of these tones."""

NEAR_HZ = 6.0
STREAMS = 50


def test_the_tap_follows_the_default_sink(server: SoundServer, tmp_path: Path) -> None:
    server.add_sink("speakers")
    with (
        running(server) as daemon,
        # PulseAudio moves the first player to the new default sink, where it is hardly heard
        playing(server, "desktop", tone(HERE_HZ, 60.0, 0.05)),
        playing(server, "speakers", tone(THERE_HZ, 60.0, 0.5)),
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):

        def feels(hz: float) -> bool:
            return abs(pitch_hz(felt()[-RATE_HZ // 10 :]) - hz) < NEAR_HZ

        wait_for(lambda: feels(HERE_FELT_HZ), "the first sink's tone")
        switched_s = time.monotonic()
        server.pactl("set-default-sink", "speakers")
        wait_for(lambda: feels(THERE_FELT_HZ), "the second sink's tone", 3.0)
        took_s = time.monotonic() - switched_s
        status = daemon.wait(lambda s: s.tap.name == "speakers.monitor", "the new tap")
    print(f"{server.kind}: the tap followed in {took_s:.2f} s")
    assert took_s < 0.5
    assert recovered(status, Cause.DEFAULT_CHANGED) == 1


def test_the_device_as_default_sink_feeds_nothing_back(server: SoundServer, tmp_path: Path) -> None:
    with (
        running(server) as daemon,
        playing(server, "desktop", tone(60.0, 60.0)),
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        server.pactl("set-default-sink", "haptic")
        status = daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        assert "feed back" in status.reason
        wait_for(lambda: TAG not in server.pactl("list", "source-outputs"), "an end of the tap")
        enough = len(felt()) + RATE_HZ
        wait_for(lambda: len(felt()) > enough, "a second")
        # PulseAudio has moved the player here: it is heard, and nothing besides
        assert float(np.abs(felt()[-RATE_HZ // 2 :]).max()) < 0.31
        server.pactl("set-default-sink", "desktop")
        daemon.wait_state(DaemonState.RUNNING)
        wait_for(lambda: felt_now(felt), "vibration again", 3.0)


@pytest.mark.parametrize(
    ("module", "arguments", "device"),
    [
        ("module-remap-sink", ("sink_name=seat", "master=desktop"), "seat"),
        ("module-loopback", ("source=haptic.monitor", "sink=desktop"), "haptic"),
    ],
)
def test_a_device_that_is_led_on_to_the_tapped_sink_feeds_nothing_back(
    server: SoundServer, module: str, arguments: tuple[str, ...], device: str
) -> None:
    loaded = server.pactl("load-module", module, *arguments)
    wait_for(lambda: device in server.names("sinks"), "the device")
    with running(server, "--wait", device=device, ready=False) as daemon:
        status = daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        assert f"forwards what '{device}' plays to 'desktop'" in status.reason
        assert TAG not in server.pactl("list", "source-outputs")
        if device == "haptic":
            server.pactl("unload-module", loaded)
            daemon.wait_state(DaemonState.RUNNING)


def test_a_microphone_is_never_felt(server: SoundServer, tmp_path: Path) -> None:
    server.add_microphone("microphone")
    with (
        running(server) as daemon,
        playing(server, "desktop", tone(HERE_HZ, 60.0)),
        playing(server, "microphone-room", tone(THERE_HZ, 60.0, 0.9)),
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        enough = len(felt()) + 2 * RATE_HZ
        wait_for(lambda: len(felt()) > enough, "two seconds")
        status = daemon.status()
        last = felt()[-RATE_HZ:]
    assert status is not None
    assert status.tap.name == "desktop.monitor"
    assert abs(pitch_hz(last) - HERE_FELT_HZ) < NEAR_HZ


def test_it_goes_on_while_fifty_streams_come_and_go(server: SoundServer, tmp_path: Path) -> None:
    quiet = ["pacat", "--playback", "--device=desktop", "--raw", "--latency-msec=200"]
    quiet += ["--format=float32le", f"--rate={RATE_HZ}", "--channels=2", "/dev/zero"]
    with (
        running(server) as daemon,
        playing(server, "desktop", tone(60.0, 60.0)),
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        flood: list[subprocess.Popen[bytes]] = []

        def rising() -> bool:
            """Whether all are there; a busy server refuses some of those that come at once."""
            alive = sum(process.poll() is None for process in flood)
            flood.extend(
                subprocess.Popen(quiet, env=server.environment, stderr=subprocess.DEVNULL)
                for _ in range(min(10, STREAMS - alive))
            )
            return count_streams(server) >= STREAMS

        try:
            wait_for(rising, "the flood", 20.0)
            wait_for(lambda: felt_now(felt), "vibration in the flood", 5.0)
            daemon.wait_state(DaemonState.RUNNING, 5.0)
        finally:
            for process in flood:
                process.kill()
            for process in flood:
                process.wait()
        wait_for(lambda: 0 <= count_streams(server) < 5, "the ebb", 10.0)
        wait_for(lambda: felt_now(felt), "vibration after the flood", 5.0)
        status = daemon.wait_state(DaemonState.RUNNING)
    moved = {cause.value: count for cause, count in status.recoveries.items() if count}
    print(f"{server.kind}: recoveries {moved}, {status.delay_line}")
    assert not recovered(status, Cause.DEVICE_MOVED)
    assert not recovered(status, Cause.SERVER_LOST)


def test_after_a_pause_of_the_process_the_delay_is_what_it_was(server: SoundServer) -> None:
    with playing(server, "desktop", tone(60.0, 60.0)), running(server) as daemon:
        status = daemon.wait(lambda s: s.delay_line.state == "locked", "a lock", 20.0)
        before, recovered_before = status.delay_line, sum(status.recoveries.values())
        daemon.process.send_signal(signal.SIGSTOP)
        stopped_s = time.monotonic()
        wait_for(lambda: time.monotonic() - stopped_s > 2.0, "two seconds")
        daemon.process.send_signal(signal.SIGCONT)
        daemon.wait(
            lambda s: (
                sum(s.recoveries.values()) > recovered_before
                or s.delay_line.resyncs + s.delay_line.underflows
                > before.resyncs + before.underflows
            ),
            "a notice of the pause",
        )
        after = daemon.wait(
            lambda s: (
                s.state is DaemonState.RUNNING
                and s.delay_line.state == "locked"
                and abs(s.delay_line.delay_ms - s.delay_line.target_ms) < 1.0
            ),
            "the delay on its target",
            20.0,
        )
        line = after.delay_line
        recovery_s = time.monotonic() - stopped_s - 2.0
    print(f"{server.kind}: {before} then {line} after {recovery_s:.2f} s, {after.recoveries}")
    # lateness that is provided for may have grown by what this machine did meanwhile
    assert line.target_ms < before.target_ms + 35.0


def count_streams(server: SoundServer) -> int:
    with suppress(ServerError):  # it refuses who comes when too many come
        return len(server.pactl("list", "short", "sink-inputs").splitlines())
    return -1

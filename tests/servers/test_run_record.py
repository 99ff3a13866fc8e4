"""`cushion run --record` and `cushion capture` on a real server: what was felt is felt again."""

import json
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.capture import Capture
from audioflinger_hook.service.state import Cause, DaemonState
from device.stream.pcms import TAG
from device.units import Float32Array
from tests.daemon.test_run_recording import overlap, recorded
from tests.servers import daemons
from tests.servers.conftest import started
from tests.servers.listening import (
    ATTEMPTS,
    RATE_HZ,
    noise,
    playing,
    recording,
    sounding,
    wait_for,
    wait_seconds,
)
from tests.support.commands import refused, vibration
from tools.sound_server import MONO, SoundServer


@pytest.fixture(params=["pipewire", pytest.param("pulse", marks=pytest.mark.soak)])
def server(request, monkeypatch):
    """A recording begins behind the mixer, alike on each server; `make soak` tries PulseAudio."""
    yield from started(request.param, monkeypatch)


def replayed(server: SoundServer, folder: Path, out: Path) -> tuple[int, str]:
    """Replay; every frame of the recorded effect has to come again. How many, and warnings."""
    done = daemons.cushion(server, "replay", folder, out, "--json")
    assert done.code == 0, done.stderr
    return overlap(folder, out, done.stdout), done.stderr


def breaks(folder: Path, stream: str) -> int:
    return sum(buffer.discontinuity for buffer in Capture(folder).buffers(stream))


@contextmanager
def polled(daemon: daemons.Daemon) -> Iterator[None]:
    ending = threading.Event()

    def poll() -> None:
        while not ending.wait(0.01):
            daemon.status()

    thread = threading.Thread(target=poll)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


def test_a_replay_gives_what_was_felt_through_a_switch_a_pause_and_idling(server, tmp_path):
    form = '[transform]\nchannels = "each"\nwindow_s = 0.06\npartials_max = 5\n'
    record, (_, named) = tmp_path / "rec", daemons.configured(tmp_path, form)
    server.add_sink("speakers")
    with (
        daemons.running(server, "--record", str(record), *named) as daemon,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
        polled(daemon),
    ):
        with (
            playing(server, "desktop", noise(60.0)),
            playing(server, "speakers", daemons.tone(110.0, 60.0)),
        ):
            wait_for(lambda: daemons.felt_now(felt), "vibration")
            wait_seconds(3.0)
            server.pactl("set-default-sink", "speakers")
            daemon.wait(lambda s: s.tap.name == "speakers.monitor", "the new tap")
            wait_seconds(2.0)
            daemon.process.send_signal(signal.SIGSTOP)
            wait_seconds(1.0)
            daemon.process.send_signal(signal.SIGCONT)
            wait_seconds(2.0)
        daemon.wait_state(DaemonState.IDLE, 30.0)
        wait_seconds(1.0)
        with playing(server, "speakers", noise(60.0, 2)):
            wait_for(lambda: daemons.felt_now(felt), "vibration again")
            wait_seconds(3.0)
        status = daemon.wait_state(DaemonState.RUNNING)
        assert status.effects_bypassed == ()
        assert daemon.end() == 130
    frames, warnings = replayed(server, record, tmp_path / "out.wav")
    again = vibration(tmp_path / "out.wav")
    assert (warnings, again.shape[1]) == ("", 2)
    assert frames > 10 * RATE_HZ
    assert np.abs(again).max() > 0.01
    assert status.recoveries[Cause.DEFAULT_CHANGED] == 1
    # the switch and the rest, for one
    for stream in ("tap", "effect"):
        assert breaks(record, stream) >= 2
    assert breaks(record, "device") >= 1
    assert not next(Capture(record).buffers("tap")).discontinuity


def test_a_replay_gives_what_was_felt_through_other_formats_and_a_new_server(server, tmp_path):
    record = tmp_path / "rec"
    server.add_sink("cd", rate_hz=44_100, channel_map=MONO)
    with daemons.running(server, "--record", str(record)) as daemon:

        def delivers(channels: int) -> bool:
            return [b.channels for b in Capture(record).buffers("tap")][-1:] == [channels]

        with playing(server, "desktop", noise(60.0)), playing(server, "cd", noise(60.0, 2)):
            wait_seconds(2.0)
            server.pactl("set-default-sink", "cd")
            wait_for(lambda: delivers(1), "sound of another format", 15.0)
            wait_seconds(2.0)
        server.kill()
        daemon.wait_state(DaemonState.WAITING_FOR_SERVER)
        server.start()
        with playing(server, "desktop", noise(60.0, 3)):
            wait_for(lambda: delivers(2), "sound of the first format", 20.0)
            wait_seconds(2.0)
        status: Any = daemon.status()
        assert daemon.end() == 130
    frames, warnings = replayed(server, record, tmp_path / "out.wav")
    assert status.recoveries[Cause.FORMAT_CHANGED] >= 2
    assert warnings == ""
    assert frames > 4 * RATE_HZ
    formats = {buffer.format for buffer in Capture(record).buffers("tap")}
    # PulseAudio lets a sink that rested take the rate of who plays
    assert formats == {(48_000, 2), (48_000 if server.kind == "pulse" else 44_100, 1)}
    assert (record / "tap-0003.wav").exists()


def test_a_replay_gives_what_was_felt_of_single_applications(server, tmp_path):
    record = tmp_path / "rec"
    with (
        playing(server, "desktop", noise(60.0)),
        daemons.running(server, "--tap", "app:Player", "--record", str(record)) as daemon,
    ):
        with playing(server, "desktop", daemons.tone(110.0, 60.0)):
            wait_for(lambda: len(recorded(record, "effect")) > 3 * RATE_HZ, "three seconds", 30.0)
        wait_seconds(1.0)
        assert daemon.end() == 130
    frames, warnings = replayed(server, record, tmp_path / "out.wav")
    assert warnings == ""
    assert frames > 2 * RATE_HZ
    assert np.abs(vibration(tmp_path / "out.wav")).max() > 0.01


def lost(sent: Float32Array, heard: Float32Array) -> int:
    """How many frames of `sent` are missing in `heard`, which has to hold nothing else."""
    at = missing = 0
    while at < len(heard):
        ahead = sent[at + missing :][: len(heard) - at]
        wrong = np.flatnonzero((ahead != heard[at : at + len(ahead)]).any(axis=1))
        if not len(wrong):
            assert len(ahead) == len(heard) - at, "more was heard than sent"
            break
        at += int(wrong[0])
        # the same again, some blocks later
        again = np.flatnonzero((sent[at + missing :] == heard[at]).all(axis=1))
        tail = heard[at : at + 32]
        found = [n for n in again if np.array_equal(sent[at + missing + n :][: len(tail)], tail)]
        assert found, f"frame {at} of {len(heard)} was never sent"
        missing += int(found[0])
    return len(sent) - len(heard)


@pytest.mark.calm
def test_the_device_stream_is_what_reached_the_device(server, tmp_path):
    record = tmp_path / "rec"
    with recording(server, "haptic.monitor", tmp_path / "felt") as felt:
        with daemons.running(server, "--record", str(record)) as daemon:
            with playing(server, "desktop", noise(4.0)):
                wait_for(lambda: daemons.felt_now(felt), "vibration")
                wait_for(lambda: not daemons.felt_now(felt, 0.5), "its end", 20.0)
            assert daemon.end() == 130
        heard = sounding(felt())
    sent = sounding(recorded(record, "device"))
    missing = lost(sent, heard)
    assert len(sent) > 2 * RATE_HZ
    # a busy server leaves out blocks now and then
    assert missing < 0.05 * len(sent)


def test_a_folder_for_a_recording_is_not_made_where_the_device_is_missing(server, tmp_path):
    refused(daemons.cushion(server, "run", "--device", "nobody", "--record", tmp_path / "new"), 3)
    assert not (tmp_path / "new").exists()


@contextmanager
def capturing(server, folder, *arguments):
    command = (*daemons.CUSHION, "capture", str(folder), *arguments)
    with daemons.program(daemons.environment(server), *command, stderr=subprocess.PIPE) as process:
        wait_for(lambda: (folder / "tap-0001.wav").exists(), "buffers")
        yield process


@pytest.mark.calm
def test_what_plays_is_captured_bit_for_bit_and_ends_after_its_seconds(server, tmp_path):
    # Whole quanta, of up to 1024 frames: PipeWire drops the rest.
    played = noise(96 * 1024 / RATE_HZ)

    def heard(attempt: int) -> Float32Array:
        folder = tmp_path / f"cap{attempt}"
        with (
            capturing(server, folder, "--tap", "sink:desktop", "--seconds", "5") as process,
            playing(server, "desktop", played),
        ):
            stdout, stderr = process.communicate(timeout=30.0)
        assert (process.returncode, stderr) == (0, "")
        assert ", 2 channels at 48000 Hz" in stdout
        frames = recorded(folder, "tap")
        assert 5.0 <= len(frames) / RATE_HZ < 5.5
        assert list(Capture(folder).warnings) == []
        return sounding(frames)

    assert any(np.array_equal(heard(attempt), played) for attempt in range(ATTEMPTS))


def test_a_capture_follows_the_default_sink_and_never_a_microphone(server, tmp_path):
    folder = tmp_path / "cap"
    server.add_microphone("microphone")
    server.add_sink("speakers")
    loud = daemons.tone(400.0, 60.0, 0.9)
    with (
        capturing(server, folder) as process,
        playing(server, "desktop", daemons.tone(110.0, 60.0, 0.1)),
        playing(server, "speakers", daemons.tone(110.0, 60.0, 0.5)),
        playing(server, "microphone-room", loud),
    ):

        def level() -> float:
            return float(np.abs(recorded(folder, "tap")[-RATE_HZ // 10 :]).max())

        wait_for(lambda: 0.05 < level() < 0.2, "the first sink", 15.0)
        server.pactl("set-default-sink", "speakers")
        wait_for(lambda: 0.4 < level() < 0.8, "the second sink", 15.0)
        # the server's news of the move may come after the sound of the second sink
        wait_for(lambda: breaks(folder, "tap") >= 1, "a discontinuity", 15.0)
        process.send_signal(signal.SIGTERM)
        stdout, stderr = process.communicate(timeout=15.0)
        assert TAG not in server.pactl("list", "source-outputs")
    assert (process.returncode, stdout, stderr) == (130, "", "cushion: interrupted\n")
    assert np.abs(recorded(folder, "tap")).max() < 0.8
    capture = Capture(folder)
    assert sum(1 for _ in capture.buffers("tap")) > 10
    assert capture.warnings == []  # it was finished
    done = daemons.cushion(server, "replay", folder, tmp_path / "out.wav", "--json")
    assert done.code == 0
    assert json.loads(done.stdout)["discontinuities"] >= 1


def test_a_tap_that_is_not_there_and_one_that_is_lost_for_good_end_a_capture(server, tmp_path):
    refused(daemons.cushion(server, "capture", tmp_path / "none", "--tap", "sink:nobody"), 3)
    with capturing(server, tmp_path / "cap") as process:
        server.kill()
        _, stderr = process.communicate(timeout=40.0)
    assert process.returncode == 4
    assert "did not come back within" in stderr
    assert len(stderr.splitlines()) == 1
    capture = Capture(tmp_path / "cap")
    assert sum(1 for _ in capture.buffers("tap")) > 0
    assert capture.warnings == []
    refused(daemons.cushion(server, "capture", tmp_path / "none"), 4)
    assert not (tmp_path / "none").exists()


def test_a_capture_goes_on_when_the_server_is_back(server, tmp_path):
    folder = tmp_path / "cap"
    with capturing(server, folder) as process:
        server.kill()
        server.start()
        with playing(server, "desktop", noise(30.0)):
            wait_for(lambda: recorded(folder, "tap")[-256:].any(), "sound", 20.0)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=15.0)
    assert process.returncode == 130
    assert breaks(folder, "tap") >= 1


def test_a_file_is_felt_on_the_device_and_ends_the_run(server, tmp_path):
    record = tmp_path / "rec"
    with recording(server, "haptic.monitor", tmp_path / "felt") as felt:
        options = ["--tap", "scene:demo", "--record", record, "--seconds", "8"]
        done = daemons.cushion(server, "run", "--device", "haptic", *options)
        assert (done.code, done.stdout) == (0, "")
        assert float(np.abs(felt()).max()) > 0.02
    assert replayed(server, record, tmp_path / "out.wav")[0] > 4 * RATE_HZ


def test_what_plays_goes_into_a_file_even_while_the_server_is_away(server, tmp_path):
    out, record = tmp_path / "out.wav", tmp_path / "rec"
    with daemons.running(server, "--record", str(record), device=f"wav:{out}") as daemon:
        with playing(server, "desktop", noise(30.0)):
            wait_for(lambda: np.abs(recorded(record, "device")).max() > 0.01, "vibration", 20.0)
        server.kill()
        daemon.wait_state(DaemonState.WAITING_FOR_SERVER)
        frames = len(recorded(record, "device"))
        wait_for(lambda: len(recorded(record, "device")) > frames + RATE_HZ, "silence")
        assert not out.exists()
        assert daemon.end() == 130
    assert np.array_equal(vibration(out), recorded(record, "device"))

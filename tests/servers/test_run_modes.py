"""What `cushion run` listens to: default sink, applications, in between; and at which volume."""

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.service.state import Cause, DaemonState
from device.stream.pcms import FALLBACK_SINK, TAG
from device.units import Float32Array
from tests.effect.test_registry import entry
from tests.pipeline.test_framework_effects import OTHER, OTHERS, OURS, effects_xml
from tests.servers import listening
from tests.servers.daemons import (
    ROOT,
    configured,
    cushion,
    felt_hz,
    felt_now,
    pitch_hz,
    running,
    stream_named,
    tone,
    vibrating,
)
from tools.sound_server import ServerError, SoundServer

MUSIC_HZ, GAME_HZ = 110.0, 400.0
MUSIC_FELT_HZ, GAME_FELT_HZ = felt_hz(MUSIC_HZ), felt_hz(GAME_HZ)  # the vibration of these tones
NEAR_HZ = 6.0


@contextmanager
def feeling(server: SoundServer, path: Path) -> Iterator[Callable[[float], bool]]:
    """Whether the last fifth of a second is vibration of this pitch."""
    with listening.recording(server, "haptic.monitor", path) as felt:
        yield lambda hz: abs(pitch_hz(felt()[-listening.RATE_HZ // 5 :]) - hz) < NEAR_HZ


def test_of_two_applications_the_one_that_was_asked_for_is_felt(server, engine, tmp_path):
    with (
        listening.playing(server, "desktop", tone(GAME_HZ, 60.0), name="Game"),
        listening.playing(server, "desktop", tone(MUSIC_HZ, 60.0), name="Music"),
        running(server, "--tap", "app:Music", engine=engine, ready=False) as daemon,
        feeling(server, tmp_path / "felt") as feels,
    ):
        listening.wait_for(lambda: feels(MUSIC_FELT_HZ), "the music alone", 20.0)
        status = daemon.wait_state(DaemonState.RUNNING)
        assert (status.tap.name, status.tap.address) == ("Music", "app:Music")


def test_what_is_excluded_is_not_felt_and_who_comes_later_is(server, tmp_path):
    _, named = configured(tmp_path, '[applications]\nexclude = ["application:Music"]\n')
    with (
        listening.playing(server, "desktop", tone(MUSIC_HZ, 60.0), name="Music"),
        running(server, *named, ready=False) as daemon,
        listening.recording(server, "haptic.monitor", tmp_path / "before") as felt,
        feeling(server, tmp_path / "felt") as feels,
    ):
        daemon.wait_state(DaemonState.IDLE, 30.0)
        assert float(np.abs(felt()).max()) == 0.0
        with listening.playing(server, "desktop", tone(GAME_HZ, 30.0), name="Game"):
            listening.wait_for(lambda: feels(GAME_FELT_HZ), "the game", 10.0)
        daemon.wait_state(DaemonState.IDLE, 30.0)


def default_sink(server: SoundServer) -> str:
    return server.pactl("get-default-sink").strip()


def test_in_between_the_sound_is_delayed_felt_and_as_before_at_the_end(server, tmp_path):
    with listening.playing(server, "desktop", tone(MUSIC_HZ, 60.0)):
        with (
            running(server, "--drop-in", "--offset-ms=-80") as daemon,
            feeling(server, tmp_path / "felt") as feels,
            listening.recording(server, "desktop.monitor", tmp_path / "heard") as heard,
        ):
            listening.wait_for(lambda: default_sink(server) == "cushion", "the virtual sink", 10.0)
            listening.wait_for(lambda: feels(MUSIC_FELT_HZ), "the music", 20.0)
            status = daemon.wait(lambda s: s.tap.name == "cushion.monitor", "the virtual tap")
            assert status.latency.offset_ms == -80.0
            listening.wait_for(lambda: felt_now(heard), "the sound")
            assert daemon.end() == 130
        assert default_sink(server) == "desktop"
        assert "cushion" not in server.pactl("list", "short", "sinks")


def test_a_tap_of_an_application_that_does_not_play_says_so_and_lists_no_sink_of_ours(server):
    with running(server, "--tap", "app:Nobody", ready=False) as daemon:
        status = daemon.wait_state(DaemonState.IDLE, 30.0)
        listed = cushion(server, "devices")
    assert "no application that the tap names plays" in status.reason
    assert "sink:haptic" in listed.stdout
    assert FALLBACK_SINK not in listed.stdout


STREAMS = 50


def test_the_tap_follows_the_default_sink(server, engine, tmp_path):
    server.add_sink("speakers")
    with (
        running(server, engine=engine) as daemon,
        # PulseAudio moves the first player to the new default sink, where it is hardly heard
        listening.playing(server, "desktop", tone(MUSIC_HZ, 60.0, 0.05)),
        listening.playing(server, "speakers", tone(GAME_HZ, 60.0, 0.5)),
        listening.recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):

        def feels(hz: float) -> bool:
            return abs(pitch_hz(felt()[-listening.RATE_HZ // 10 :]) - hz) < NEAR_HZ

        listening.wait_for(lambda: feels(MUSIC_FELT_HZ), "the first sink's tone")
        server.pactl("set-default-sink", "speakers")
        limit_s = {"python": 0.5, "native": 1.0}[engine]
        listening.wait_for(lambda: feels(GAME_FELT_HZ), "the second sink's tone", limit_s)
        status = daemon.wait(lambda s: s.tap.name == "speakers.monitor", "the new tap")
    assert status.recoveries[Cause.DEFAULT_CHANGED] == 1


def test_the_device_as_default_sink_feeds_nothing_back(server, engine, tmp_path):
    with vibrating(server, tmp_path, tone(60.0, 60.0), engine=engine) as (daemon, felt):
        server.pactl("set-default-sink", "haptic")
        assert "feed back" in daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE).reason
        listening.wait_for(
            lambda: TAG not in server.pactl("list", "source-outputs"), "an end of the tap"
        )
        listening.more(felt, 1.0)
        # PulseAudio has moved the player here: it is heard, and nothing besides
        assert float(np.abs(felt()[-listening.RATE_HZ // 2 :]).max()) < 0.31
        server.pactl("set-default-sink", "desktop")
        daemon.wait_state(DaemonState.RUNNING)
        listening.wait_for(lambda: felt_now(felt), "vibration again", 3.0)


@pytest.mark.parametrize(
    ("module", "arguments", "device"),
    [
        ("module-remap-sink", ("sink_name=seat", "master=desktop"), "seat"),
        ("module-loopback", ("source=haptic.monitor", "sink=desktop"), "haptic"),
    ],
)
def test_a_device_led_on_to_the_tapped_sink_feeds_nothing_back(server, module, arguments, device):
    loaded = server.pactl("load-module", module, *arguments)
    listening.wait_for(lambda: device in server.names("sinks"), "the device")
    with running(server, "--wait", device=device, ready=False) as daemon:
        status = daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        assert f"forwards what '{device}' plays to 'desktop'" in status.reason
        assert TAG not in server.pactl("list", "source-outputs")
        if device == "haptic":
            server.pactl("unload-module", loaded)
            daemon.wait_state(DaemonState.RUNNING)


def test_a_microphone_is_never_felt(server, engine, tmp_path):
    server.add_microphone("microphone")
    loud = tone(GAME_HZ, 60.0, 0.9)
    with (
        listening.playing(server, "microphone-room", loud),
        vibrating(server, tmp_path, tone(MUSIC_HZ, 60.0), engine=engine) as (daemon, felt),
    ):
        last = listening.more(felt, 2.0)[-listening.RATE_HZ :]
        status: Any = daemon.status()
    assert status.tap.name == "desktop.monitor"
    assert abs(pitch_hz(last) - MUSIC_FELT_HZ) < NEAR_HZ


def test_it_goes_on_while_fifty_streams_come_and_go(server, engine, tmp_path):
    quiet = ["pacat", "--playback", "--device=desktop", "--raw", "--latency-msec=200"]
    quiet += ["--format=float32le", f"--rate={listening.RATE_HZ}", "--channels=2", "/dev/zero"]
    with vibrating(server, tmp_path, tone(60.0, 60.0), engine=engine) as (daemon, felt):
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
            listening.wait_for(rising, "the flood", 20.0)
            listening.wait_for(lambda: felt_now(felt), "vibration in the flood", 5.0)
            daemon.wait_state(DaemonState.RUNNING, 5.0)
        finally:
            for process in flood:
                process.kill()
            for process in flood:
                process.wait()
        listening.wait_for(lambda: 0 <= count_streams(server) < 5, "the ebb", 10.0)
        listening.wait_for(lambda: felt_now(felt), "vibration after the flood", 5.0)
        status = daemon.wait_state(DaemonState.RUNNING)
    for cause in (Cause.DEVICE_MOVED, Cause.SERVER_LOST, Cause.ENGINE_LOST):
        assert not status.recoveries[cause]


def test_after_a_pause_of_the_process_the_delay_is_what_it_was(server):
    with listening.playing(server, "desktop", tone(60.0, 60.0)), running(server) as daemon:
        status = daemon.wait(lambda s: s.delay_line.state == "locked", "a lock", 20.0)
        before, recovered_before = status.delay_line, sum(status.recoveries.values())
        daemon.process.send_signal(signal.SIGSTOP)
        listening.wait_seconds(2.0)
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
    # lateness that is provided for may have grown by what this machine did meanwhile
    assert after.delay_line.target_ms < before.target_ms + 35.0


def count_streams(server: SoundServer) -> int:
    with suppress(ServerError):  # it refuses who comes when too many come
        return len(server.pactl("list", "short", "sink-inputs").splitlines())
    return -1


@pytest.mark.parametrize(
    ("misbehave", "reason"),
    [
        ("raise KeyError('lost')", "raised KeyError: 'lost' in process (other_package.py, line "),
        ("import time; time.sleep(0.6)", "kept the audio thread for over 0.4 s in process"),
    ],
)
def test_an_effect_that_fails_or_waits_is_named_on_the_terminal_and_vibration_goes_on(
    server, tmp_path, site, misbehave, reason
):
    site("other_package", OTHER.replace("MISBEHAVE", misbehave), entry("other_package:LIBRARY"))
    applied = effects_xml("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    (tmp_path / "audio_effects.xml").write_text(applied)
    _, named = configured(tmp_path, 'effects_file = "audio_effects.xml"\n')
    path = {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}
    with (
        listening.playing(server, "desktop", tone(300.0, 60.0)),
        running(server, *named, ready=False, variables=path) as daemon,
        listening.recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        told = f"effect bypassed: session 0, Other: {reason}"
        listening.wait_for(lambda: told in daemon.stderr, told, 15.0)
        listening.wait_for(lambda: felt_now(felt), "vibration", 15.0)
        daemon.wait_ready()


CHANGE_DB = 1.0  # 20 dB that are not undone give 12.6 dB
STEP_CHANGE_DB = 2.0  # of the level after a step, against that before
TAP_DB = 8.0
"""Sound and the news of its volume come some ms apart, and a step of a tone is a click. So a step
is felt as a tap of up to 0.1 s: by the 6.5 dB of a rise at most, and its own 1.3 dB."""

SETTLES_S = 4.5  # until a louder moment of 20 dB is forgotten
AS_THE_PROGRAMME = 0.06  # a tone of 110 Hz as loud as the programme at first
WINDOW_S = 0.6
PART_FRAMES = 2_400
"""The median of parts is the level: a gap of a busy machine is none of the volume's."""


def felt_db(felt: Callable[[], Float32Array], after_s: float) -> float:
    first = len(felt()) + int(after_s * listening.RATE_HZ)
    listening.wait_for(lambda: len(felt()) > first + WINDOW_S * listening.RATE_HZ, "more of it")
    heard = felt()[first : first + int(WINDOW_S * listening.RATE_HZ)]
    return float(np.median([listening.level_db(part) for part in parts_of(heard)]))


def parts_of(frames: Float32Array) -> list[Float32Array]:
    return np.array_split(frames, len(frames) // PART_FRAMES)


def test_a_volume_of_stream_or_sink_is_not_felt(server, tmp_path, engine):
    with (
        running(server, "--profile", "cinema", engine=engine) as daemon,
        listening.playing(server, "desktop", tone(110.0, 90.0, AS_THE_PROGRAMME)),
        listening.recording(server, "haptic.monitor", tmp_path / "felt", stays=True) as felt,
    ):
        before_db = felt_db(felt, 3.0)
        assert before_db > -40.0
        player = stream_named(server, "Player")
        # a factor: pactl 17 sets a stream to 0 for a volume in dB
        server.pactl("set-sink-input-volume", player, "0.1")
        stream_db = felt_db(felt, SETTLES_S)
        status: Any = daemon.status()
        server.pactl("set-sink-volume", "desktop", "-12dB")
        both_db = felt_db(felt, SETTLES_S)
        both: Any = daemon.status()
        server.pactl("set-sink-volume", "desktop", "100%")
        server.pactl("set-sink-input-volume", player, "100%")
        again_db, begun = felt_db(felt, SETTLES_S), len(felt())
        for percent in (95, 90, 85, 80, 85, 90, 95, 100):  # as keys of a keyboard make it
            server.pactl("set-sink-volume", "desktop", f"{percent}%")
            felt_db(felt, 0.0)
        stepped = felt()[begun:]
    found = [before_db, stream_db, both_db, again_db]
    steps = [listening.level_db(part) for part in parts_of(stepped)]
    print(f"{server.kind}, {engine}: {np.round(found, 2)} dB, steps {np.ptp(steps):.1f} dB")
    assert status.volume_db == pytest.approx(-20.0, abs=0.2)
    assert both.volume_db == pytest.approx(-32.0, abs=0.2)
    assert found == pytest.approx([before_db] * 4, abs=CHANGE_DB)
    assert max(steps) - before_db < TAP_DB
    settled = [float(np.median(part)) for part in np.array_split(steps, 8)]
    off = [level for level in settled if abs(level - before_db) > STEP_CHANGE_DB]
    assert not off, off


def test_the_paper_s_profile_feels_the_volume_as_it_is_heard(server, tmp_path):
    with (
        running(server, "--profile", "paper") as daemon,
        listening.playing(server, "desktop", tone(110.0, 90.0, 0.2)),
        listening.recording(server, "haptic.monitor", tmp_path / "felt", stays=True) as felt,
    ):
        before_db = felt_db(felt, 2.0)
        server.pactl("set-sink-input-volume", stream_named(server, "Player"), "0.1")
        assert felt_db(felt, 0.4) == pytest.approx(before_db - 20.0, abs=0.5)
        status: Any = daemon.status()
    assert status.volume_db == 0.0

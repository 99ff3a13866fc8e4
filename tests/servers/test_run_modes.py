"""`cushion run` with single applications, standing in between, and both in the user's config."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from audioflinger_hook.service.state import DaemonState
from device.stream.pcms import FALLBACK_SINK
from tests.servers.daemons import cushion, felt_hz, felt_now, pitch_hz, running, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tools.sound_server import SoundServer

MUSIC_HZ, GAME_HZ = 110.0, 400.0
MUSIC_FELT_HZ, GAME_FELT_HZ = felt_hz(MUSIC_HZ), felt_hz(GAME_HZ)
"""The vibration of these tones."""

NEAR_HZ = 6.0


@contextmanager
def feeling(server: SoundServer, path: Path) -> Iterator[Callable[[float], bool]]:
    """Whether the last fifth of a second is vibration of this pitch."""
    with recording(server, "haptic.monitor", path) as felt:
        yield lambda hz: abs(pitch_hz(felt()[-RATE_HZ // 5 :]) - hz) < NEAR_HZ


def config(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def test_of_two_applications_the_one_that_was_asked_for_is_felt(
    server: SoundServer, tmp_path: Path
) -> None:
    with (
        playing(server, "desktop", tone(GAME_HZ, 60.0), name="Game"),
        playing(server, "desktop", tone(MUSIC_HZ, 60.0), name="Music"),
        running(server, "--tap", "app:Music", ready=False) as daemon,
        feeling(server, tmp_path / "felt") as feels,
    ):
        wait_for(lambda: feels(MUSIC_FELT_HZ), "the music alone", 20.0)
        status = daemon.wait_state(DaemonState.RUNNING)
        assert status.tap.name == "Music"
        assert status.tap.address == "app:Music"


def test_what_is_excluded_is_not_felt_and_who_comes_later_is(
    server: SoundServer, tmp_path: Path
) -> None:
    rules = config(tmp_path / "c.toml", '[applications]\nexclude = ["application:Music"]\n')
    with (
        playing(server, "desktop", tone(MUSIC_HZ, 60.0), name="Music"),
        running(server, "--config", rules, ready=False) as daemon,
        recording(server, "haptic.monitor", tmp_path / "before") as felt,
        feeling(server, tmp_path / "felt") as feels,
    ):
        daemon.wait_state(DaemonState.IDLE, 30.0)
        assert float(np.abs(felt()).max()) == 0.0
        with playing(server, "desktop", tone(GAME_HZ, 30.0), name="Game"):
            wait_for(lambda: feels(GAME_FELT_HZ), "the game", 10.0)
        daemon.wait_state(DaemonState.IDLE, 30.0)


def test_a_rule_with_a_mistake_starts_nothing(server: SoundServer, tmp_path: Path) -> None:
    rules = config(tmp_path / "c.toml", '[applications]\ninclude = ["rule:Music"]\n')
    done = cushion(server, "run", "--device", "haptic", "--config", rules)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "rule:Music" in done.stderr


def default_sink(server: SoundServer) -> str:
    return server.pactl("get-default-sink").strip()


def test_in_between_the_sound_is_delayed_felt_and_as_before_at_the_end(
    server: SoundServer, tmp_path: Path
) -> None:
    with playing(server, "desktop", tone(MUSIC_HZ, 60.0)):
        with (
            running(server, "--drop-in", "--offset-ms=-80") as daemon,
            feeling(server, tmp_path / "felt") as feels,
            recording(server, "desktop.monitor", tmp_path / "heard") as heard,
        ):
            wait_for(lambda: default_sink(server) == "cushion", "the virtual sink", 10.0)
            wait_for(lambda: feels(MUSIC_FELT_HZ), "the music", 20.0)
            status = daemon.wait(lambda s: s.tap.name == "cushion.monitor", "the virtual tap")
            assert status.latency.offset_ms == -80.0
            wait_for(lambda: felt_now(heard), "the sound")
            assert daemon.end() == 130
        assert default_sink(server) == "desktop"
        assert "cushion" not in server.pactl("list", "short", "sinks")


def test_a_daemon_killed_in_between_leaves_the_sound_going_and_the_next_one_puts_all_back(
    server: SoundServer, tmp_path: Path
) -> None:
    with (
        playing(server, "desktop", tone(MUSIC_HZ, 90.0)),
        recording(server, "desktop.monitor", tmp_path / "heard") as heard,
    ):
        with running(server, "--drop-in") as daemon:
            wait_for(lambda: default_sink(server) == "cushion", "the virtual sink", 10.0)
            wait_for(lambda: felt_now(heard), "the sound")
            began = len(heard())
            daemon.process.send_signal(signal.SIGKILL)
            daemon.process.wait(5.0)
            wait_for(lambda: len(heard()) > began + 2 * RATE_HZ, "two seconds")
            blocks = heard()[began : began + 2 * RATE_HZ, 0].reshape(-1, RATE_HZ // 10)
            assert np.abs(blocks).max(axis=1).min() > 0.1
        with running(server, "--drop-in") as again:
            again.wait(lambda s: s.tap.name == "cushion.monitor", "the virtual tap")
            assert again.end() == 130
        assert default_sink(server) == "desktop"
        wait_for(lambda: felt_now(heard), "the sound as ever")


def test_silence_that_plays_lets_it_rest_and_the_sound_in_it_is_felt(
    server: SoundServer, tmp_path: Path
) -> None:
    silence = np.zeros((25 * RATE_HZ, 2), np.float32)
    with (
        running(server) as daemon,
        feeling(server, tmp_path / "felt") as feels,
        playing(server, "desktop", np.concatenate([silence, tone(MUSIC_HZ, 30.0)])),
    ):
        daemon.wait_state(DaemonState.IDLE, 24.0)
        wait_for(lambda: feels(MUSIC_FELT_HZ), "the music", 30.0)
        daemon.wait_state(DaemonState.RUNNING)


def test_a_tap_of_an_application_that_does_not_play_says_so_and_lists_no_sink_of_ours(
    server: SoundServer,
) -> None:
    with running(server, "--tap", "app:Nobody", ready=False) as daemon:
        status = daemon.wait_state(DaemonState.IDLE, 30.0)
        listed = cushion(server, "devices")
    assert "no application that the tap names plays" in status.reason
    assert "sink:haptic" in listed.stdout
    assert FALLBACK_SINK not in listed.stdout

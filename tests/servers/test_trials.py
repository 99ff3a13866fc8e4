"""Trials on a real server: sound and vibration together, ended softly, and nothing else felt."""

import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.signal import correlate

from audioflinger_hook.daemon.offset import DECLARED
from audioflinger_hook.trials.player import DaemonPlayer, NotPlayedError, mixed
from device.errors import LostError, NotFoundError, UsageError
from tests.servers.daemons import (
    FELT,
    environment,
    felt_hz,
    felt_now,
    pitch_hz,
    program,
    running,
    tone,
)
from tests.servers.listening import RATE_HZ, more, playing, recording, wait_for
from tests.servers.slow_sinks import SLOW, DeclaringSink
from tools.live_latency.bursts import GraphOnce, recorded_together

pytestmark = pytest.mark.servers

WITHIN_FRAMES = 96  # 2 ms
SECONDS = 0.5
NEAR = RATE_HZ // 2  # frames between sound and vibration, at most


@pytest.fixture
def noise(tmp_path):
    """A WAV of noise, the sound and the vibration of a trial."""
    path = tmp_path / "noise.wav"
    samples = np.random.default_rng(1).uniform(-0.4, 0.4, round(SECONDS * RATE_HZ))
    soundfile.write(path, samples, RATE_HZ, subtype="FLOAT")
    return path


@pytest.fixture
def long(tmp_path):
    """A WAV of 20 s of a tone."""
    path = tmp_path / "long.wav"
    soundfile.write(path, tone(70.0, 20.0)[:, 0], RATE_HZ, subtype="FLOAT")
    return path


def player_of():
    """A player of the daemon, which is closed at the end of the block."""
    return closing(DaemonPlayer(time.monotonic))


def lags(path: Path) -> list[int]:
    """By how many frames the second channel of a recording comes after the first, in each trial."""
    heard, felt = soundfile.read(path)[0].T
    loud = np.flatnonzero(np.abs(heard) > 1e-4)
    found = []
    for begin in loud[np.diff(loud, prepend=-RATE_HZ) > RATE_HZ // 10]:
        trial = heard[begin : begin + round(SECONDS * RATE_HZ)]
        near = felt[max(0, begin - NEAR) : begin + len(trial) + NEAR]
        found.append(int(np.argmax(correlate(near, trial, "valid"))) - min(NEAR, begin))
    return found


def link_a_clock(server) -> None:
    """Let another sink drive the graph, as the monitor of a sink that drives is a cycle late."""
    server.add_sink("clock", "priority.driver=30000")
    graph = GraphOnce(server.environment)
    output = graph.ports("clock", "monitor_")["FL"]
    graph.link(output, graph.ports("burst-recorder", "input_")["FL"])


def test_sound_and_vibration_of_a_trial_coincide(pipewire, noise, tmp_path):
    both = ("desktop", "monitor_FL"), ("haptic", "monitor_FL")
    with running(pipewire, engine="native"), player_of() as player:
        assert player.wait(10.0)
        with recorded_together(*both, tmp_path, pipewire.environment, RATE_HZ) as path:
            link_a_clock(pipewire)
            played = [player.play(noise, noise) for _ in range(5)]
    found = lags(path)
    print(found, played)
    assert len(found) == 5
    assert max(np.abs(found)) <= WITHIN_FRAMES
    _, felt = soundfile.read(path)[0].T
    level_db = 10.0 * np.log10(np.sum(felt**2) / (5 * SECONDS * RATE_HZ))
    for one in played:
        assert one.level_dbfs == pytest.approx(level_db, abs=0.3)
        assert one.sound_began_s == one.vibration_began_s
        assert one.seconds == pytest.approx(SECONDS, abs=1e-3)
        assert not one.stopped


def test_the_vibration_waits_for_a_sound_whose_sink_declares_a_delay(
    timed_pipewire, noise, tmp_path
):
    DeclaringSink(timed_pipewire, 0.2)
    timed_pipewire.choose_default(SLOW)
    both = (SLOW, "monitor_FL"), ("haptic", "monitor_FL")
    environ = timed_pipewire.environment
    with running(timed_pipewire, engine="native") as daemon, player_of() as player:
        assert player.wait(10.0)
        status = daemon.wait(lambda one: one.offset_reason == DECLARED, "the declared delay")
        with recorded_together(*both, tmp_path, environ, RATE_HZ) as path:
            for _ in range(3):
                player.play(noise, noise)
    own_frames = RATE_HZ * 1e-3 * (status.offset_ms + status.latency.driving_ms)
    found = lags(path)
    print(found, own_frames)
    assert len(found) == 3
    # the monitor of SLOW, which drives the graph, is a cycle late
    assert np.abs(np.array(found) + 1_024 - own_frames).max() <= WITHIN_FRAMES


@pytest.mark.parametrize("how", ["stop", "close"])
def test_a_trial_ends_at_once_with_a_fade(pipewire, long, how, tmp_path):
    with (
        running(pipewire, engine="native"),
        player_of() as player,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        assert player.wait(10.0)

        def end() -> None:
            wait_for(lambda: felt_now(felt, 0.2), "vibration")
            getattr(player, how)()

        ending = threading.Thread(target=end)
        ending.start()
        if how == "stop":
            played = player.play(long, long)
            assert played.stopped
            assert 0.0 < played.seconds < 2.0
        else:
            with pytest.raises(LostError):
                player.play(long, long)
        ending.join()
        wait_for(lambda: not np.abs(felt()[-RATE_HZ // 4 :]).max() > FELT, "silence", 2.0)
    ends = int(np.flatnonzero(np.abs(felt()[:, 0]) > FELT)[-1])
    last = felt()[ends - RATE_HZ // 20 : ends + 1, 0]  # whatever a busy machine loses before
    assert np.abs(last).max() > 0.05  # it faded within 50 ms
    assert np.abs(np.diff(last)).max() < 0.01  # 0.3 of full scale at 70 Hz: at most 0.0028


PLAYS = """
import time
import numpy as np
from audioflinger_hook.trials.player import DaemonPlayer
player = DaemonPlayer(time.monotonic)
assert player.wait(10.0)
player.play(None, 0.3 * np.sin(2.0 * np.pi * 220.0 * np.arange(960_000) / 48_000.0)[:, None])
"""


def test_a_killed_program_ends_its_trial_and_the_tapped_sound_is_felt_again(pipewire, tmp_path):
    def hz() -> float:
        return pitch_hz(felt()[-RATE_HZ // 2 :])

    with (
        playing(pipewire, "desktop", tone(110.0, 60.0)),
        running(pipewire, engine="native"),
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration of the tone")
        with program(environment(pipewire), sys.executable, "-c", PLAYS) as killed:
            wait_for(lambda: hz() == pytest.approx(220.0, abs=3.0), "vibration of the trial", 40.0)
            killed.kill()
            wait_for(lambda: hz() == pytest.approx(felt_hz(110.0), abs=3.0), "that of the tone")
        assert "trials" not in pipewire.pactl("list", "short", "sinks")


def test_an_earlier_stop_counts_and_only_trials_with_sound_need_an_output(pipewire, long, noise):
    with running(pipewire, engine="native"), player_of() as player:
        assert player.wait(10.0)
        player.stop()
        assert player.play(None, long).stopped
        player.may_play()
        assert not player.play(None, noise).stopped
        pipewire.choose_default("haptic")
        with pytest.raises(NotPlayedError, match="choose another default sink"):
            player.play(noise, noise)


def test_tapped_sound_is_not_felt_during_a_session_and_felt_after_it(pipewire, tmp_path):
    with (
        playing(pipewire, "desktop", tone(110.0, 60.0)),
        running(pipewire, engine="native"),
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        assert np.abs(more(felt, 1.0)).max() > FELT
        with player_of() as player:
            assert player.wait(10.0)
            more(felt, 0.5)
            assert np.abs(more(felt, 1.0)).max() < FELT
            with (
                player_of() as another,
                pytest.raises(UsageError, match="another program plays trials"),
            ):
                another.wait(0.0)
        wait_for(lambda: np.abs(felt()[-RATE_HZ // 10 :]).max() > FELT, "vibration")
        assert "trials" not in pipewire.pactl("list", "short", "sinks")


def test_a_trial_whose_device_is_unplugged_was_not_played_and_is_played_when_it_is_back(
    pipewire, long, noise
):
    with running(pipewire, engine="native"), player_of() as player:
        assert player.wait(10.0)
        unplugging = threading.Timer(
            1.0, pipewire.pactl, ("unload-module", pipewire._modules["haptic"])
        )
        unplugging.start()
        with pytest.raises(NotPlayedError, match=r"not played: waiting-for-device: .*haptic"):
            player.play(long, long)
        unplugging.join()
        assert not player.wait(0.2)
        assert "waiting-for-device" in player.why_not
        pipewire.add_sink("haptic")
        assert player.wait(10.0)
        assert player.play(noise, noise).level_dbfs > -30.0


def test_protection_and_exposure_are_in_the_way_of_a_trial(pipewire, long, tmp_path):
    options = ("--rig", "consumer", "--protection", "on")
    loud = tmp_path / "loud.wav"
    soundfile.write(loud, 3.3 * tone(40.0, 1.0)[:, 0], RATE_HZ, subtype="FLOAT")
    soft = tmp_path / "soft.wav"
    soundfile.write(soft, 0.1 * tone(40.0, 1.0)[:, 0], RATE_HZ, subtype="FLOAT")
    with running(pipewire, *options, engine="native"), player_of() as player:
        assert player.wait(15.0)
        quiet, played, again = (player.play(None, one) for one in (soft, loud, soft))
    print(quiet, played, again)
    assert again.level_dbfs == pytest.approx(quiet.level_dbfs, abs=1.0)
    assert quiet.protection_db == 0.0
    assert played.sound_began_s is None
    assert played.protection_db > 1.0
    assert played.a8_m_s2 is not None
    assert 0.0 < played.a8_m_s2 < 0.1
    assert played.vdv_m_s175 is not None
    assert 0.1 < played.vdv_m_s175 < 9.1


def test_without_a_daemon_and_with_the_python_engine_it_says_what_to_do(pipewire):
    with player_of() as player, pytest.raises(NotFoundError, match="start one with `cushion run`"):
        player.status()
    with running(pipewire), player_of() as player:
        assert not player.wait(0.5)
        assert "trials need the native engine" in player.why_not


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (("missing.wav", None), "cannot be played"),
        ((None, "stereo.wav"), "has 2 channels; allowed: up to 1"),
    ],
)
def test_files_that_cannot_be_played_are_named(files, said, tmp_path):
    soundfile.write(tmp_path / "stereo.wav", tone(70.0, 0.1), RATE_HZ)
    with pytest.raises(UsageError, match=said):
        mixed(*(None if name is None else tmp_path / name for name in files))

"""`cushion run` on a real sound server: what plays is felt, whatever becomes of the rest."""

import json
import math
import os
import signal
import subprocess
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.service.state import Cause, DaemonState
from audioflinger_hook.service.status import Status
from audioflinger_hook.sources import mixdown
from device.units import Float32Array
from tests.servers import daemons
from tests.servers.bare_streams import bare_streams
from tests.servers.listening import RATE_HZ, more, playing, recording, wait_for, wait_seconds
from tests.servers.test_run_reload import connections, reload
from tests.servers.witness import Verdict, tears, witness_tone
from tests.support.commands import refused
from tests.support.parameters import TWO_SHAKERS
from tools.live_latency.pauses import PauseWitness
from tools.sound_server import SoundServer

pytestmark = pytest.mark.calm

SCENE_S = 8.0

PLAYING_PERCENT, IDLE_PERCENT = 8.0, 0.5  # of one core, for the whole daemon
TIMES_BARE = 3.8  # of what two streams cost that do nothing, at the same time: 2.4 to 3.2 measured
WINDOWS = 5  # the best counts: other programs make caches cold and processor time long


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    source, target = folder / "sound.wav", folder / "vibration.wav"
    sound = mixdown(demo_scene())[: int(SCENE_S * RATE_HZ)].astype(np.float32)
    assert demo_scene().samplerate == RATE_HZ
    soundfile.write(source, sound, RATE_HZ, subtype="FLOAT")
    render_file(source, target, Settings(profile=LIVE_DEFAULT))
    return sound, soundfile.read(target, always_2d=True)[0][:, 0]


def take(server: SoundServer, sound: Float32Array, folder: Path) -> tuple[Float32Array, str, float]:
    """What is felt of a sound, the daemon's status, and how long a core was taken away in s.

    The time is infinite if another server lost a cycle.
    """
    with (
        witness_tone(folder) as other,
        closing(PauseWitness()) as witness,
        daemons.running(server) as daemon,
        recording(server, "haptic.monitor", folder / "felt") as felt,
        playing(server, "desktop", sound),
    ):
        begin = len(other())
        wait_for(lambda: daemons.felt_now(felt), "vibration")
        enough = len(felt()) + int((SCENE_S + 0.5) * RATE_HZ)
        wait_for(lambda: len(felt()) > enough, "the whole of it", 2.0 * SCENE_S)
        status = str(daemon.status())
        away_s = max((one.seconds for one in witness.core_pauses()), default=0.0)
        if tears(other()[begin:]):
            away_s = math.inf
    return felt()[:, 0], status, away_s


def test_what_plays_is_felt_as_a_file_of_it_is_rendered(server, scene, tmp_path):
    """A take counts only if no core was taken away for 20 ms, which no stream outlasts."""
    sound, vibration = scene
    shown, verdict = False, Verdict("felt as rendered", needed=1)
    while not shown:
        heard, status, away_s = take(server, sound, tmp_path)
        alike = daemons.likeness(daemons.envelope(heard), daemons.envelope(vibration))
        lag = daemons.best_lag(daemons.envelope(heard), daemons.envelope(vibration))
        got = heard[lag * RATE_HZ // 1_000 :][: len(sound)].astype(np.float64)
        level_db = float(10.0 * np.log10(np.mean(got**2) / np.mean(vibration**2)))
        found = f"correlation {alike:.4f}, level {level_db:+.2f} dB, {status}"
        print(f"{server.kind}: {found}, a core was away for {1e3 * away_s:.0f} ms")
        good = alike >= 0.97 and abs(level_db) <= 0.5
        shown = verdict.add(found, good=good, witness_torn=away_s > 0.02)


def test_it_ends_after_the_seconds_asked_for_and_tells_what_it_does_until_then(server):
    with (
        playing(server, "desktop", daemons.tone(60.0, 30.0)),
        daemons.running(server, "--seconds", "6") as daemon,
    ):
        status = daemon.wait(lambda s: s.levels.vibration.peak_dbfs > -60.0, "vibration")
        assert status.state is DaemonState.RUNNING
        assert (status.tap.name, status.device.name) == ("desktop.monitor", "haptic")
        assert status.pid == daemon.process.pid
        assert 5.0 < status.latency.total_ms < 250.0
        assert -20.0 < status.levels.sound.rms_dbfs < -6.0
        assert status.levels.vibration.peak_dbfs <= 0.0
        assert daemons.cushion(server, "status", "--json").stdout.startswith("{")
        assert daemon.wait_exit() == 0


def test_there_is_one_daemon_and_when_it_is_ended_nothing_of_it_is_left(server):
    before = daemons.modules_of(server)
    with daemons.running(server) as daemon:
        assert "cushion.stream" in server.pactl("list", "sink-inputs")
        second = daemons.cushion(server, "run", "--device", "haptic", "--seconds", "1")
        assert str(daemon.process.pid) in refused(second)
        assert daemon.end() == 130
    assert "Traceback" not in daemon.stderr
    assert [path.name for path in (server.folder / "cushion").glob("*.sock*")] == []
    assert daemons.modules_of(server) == before
    assert server.pactl("list", "short", "sink-inputs") == ""
    assert server.pactl("list", "short", "source-outputs") == ""
    assert daemons.cushion(server, "status").code == 3


BACK_S = {"python": 2.0, "native": 1.0}  # until it plays again once a fault is over
RECORDERS = 5.0  # times as long as a recorder, which takes 0.1 s, on a busy machine


def test_the_device_vanishes_and_nobody_else_plays_its_vibration(server, engine, tmp_path):
    server.add_sink("speakers")
    server.choose_default("speakers")
    with (
        playing(server, "desktop", daemons.tone(60.0, 90.0)),
        recording(server, "speakers.monitor", tmp_path / "elsewhere") as heard,
        daemons.running(server, "--tap", "sink:desktop", engine=engine) as daemon,
    ):
        for _ in range(3):
            with recording(server, "haptic.monitor", tmp_path / "felt") as felt:
                wait_for(partial(daemons.felt_now, felt), "vibration")
            server.remove("haptic")
            assert "haptic" in daemon.wait_state(DaemonState.WAITING_FOR_DEVICE).reason
            more(heard, 0.5)
            server.add_sink("haptic")
            back_s = time.monotonic()
            with recording(server, "haptic.monitor", tmp_path / "again") as again:
                recorder_s = time.monotonic() - back_s
                wait_for(partial(daemons.felt_now, again), "it again")
            least_s = max(BACK_S[engine], RECORDERS * recorder_s)
            assert time.monotonic() - back_s < least_s
        status = daemon.wait_state(DaemonState.RUNNING)
        assert not heard().any()
    assert status.recoveries[Cause.DEVICE_LOST] >= 3


def test_the_server_is_killed_and_comes_back(server, engine, tmp_path):
    with daemons.running(server, engine=engine) as daemon:
        for _ in range(2):
            with playing(server, "desktop", daemons.tone(60.0, 30.0)):
                daemon.wait(lambda s: s.levels.vibration.peak_dbfs > -60.0, "vibration")
                server.kill()
            daemon.wait_state(DaemonState.WAITING_FOR_SERVER)
            server.start()
            with (
                playing(server, "desktop", daemons.tone(60.0, 30.0)),
                recording(server, "desktop.monitor", tmp_path / "sound") as sound,
                recording(server, "haptic.monitor", tmp_path / "felt") as felt,
            ):
                # the server itself takes its time to link streams
                wait_for(partial(daemons.felt_now, sound), "sound")
                wait_for(partial(daemons.felt_now, felt), "vibration", BACK_S[engine])
                status = daemon.wait_state(DaemonState.RUNNING)
    assert status.engine == engine
    assert status.recoveries[Cause.SERVER_LOST] >= 2  # a busy server may be lost as it starts


def test_without_a_server_it_says_so_or_waits_for_one(server):
    server.kill()
    alone = daemons.cushion(server, "run", "--device", "haptic")
    assert refused(alone, 4).startswith("cushion: error: no sound server answers")
    with daemons.running(server, "--wait", ready=False) as daemon:
        daemon.wait_state(DaemonState.WAITING_FOR_SERVER)
        server.start()
        daemon.wait_ready()


def least_cpu_percent(daemon: daemons.Daemon, limit_percent: float) -> float:
    least = 100.0
    for _ in range(WINDOWS):
        least = min(least, daemons.cpu_percent(daemon.process.pid)[0])
        if least <= limit_percent:
            break
    return least


def beside_bare_streams(daemon: daemons.Daemon, server: SoundServer) -> tuple[float, float]:
    """What daemon and bare streams use, in the window where their ratio is least."""
    frames = LiveSettings().block_frames
    with bare_streams(server.environment, "desktop.monitor", "haptic", block_frames=frames) as bare:
        pids = (daemon.process.pid, bare.process.pid)
        windows = [daemons.cpu_percent(*pids) for _ in range(WINDOWS)]
    daemon_percent, bare_percent = min(windows, key=lambda window: window[0] / window[1])
    return daemon_percent, bare_percent


def test_silence_costs_little_and_the_sound_after_it_is_felt(server, scene, tmp_path):
    sound, _ = scene
    with (
        daemons.running(server) as daemon,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        daemon.wait_state(DaemonState.IDLE)
        idle_percent, began = least_cpu_percent(daemon, IDLE_PERCENT), len(felt())
        with playing(server, "desktop", np.tile(sound, (8, 1))):
            wait_for(lambda: daemons.felt_now(felt), "vibration", 2.0)
            playing_percent = least_cpu_percent(daemon, PLAYING_PERCENT)
            beside_percent = bare_percent = None
            if playing_percent > PLAYING_PERCENT:
                beside_percent, bare_percent = beside_bare_streams(daemon, server)
            daemon.wait_state(DaemonState.RUNNING)
        assert np.abs(felt()[began:]).max() > daemons.FELT
    assert idle_percent <= IDLE_PERCENT
    if beside_percent is not None and bare_percent is not None:
        assert beside_percent <= TIMES_BARE * bare_percent
        pytest.skip(
            f"{playing_percent:.1f} % of a core, over {PLAYING_PERCENT:g}: not shown on a machine "
            f"where streams that do nothing take {bare_percent:.1f} %"
        )


def test_the_tapped_sink_is_removed_and_added_again(server, engine, tmp_path):
    server.add_sink("speakers")
    with (
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
        daemons.running(server, "--tap", "sink:speakers", engine=engine) as daemon,
    ):
        with playing(server, "speakers", daemons.tone(60.0, 60.0)):
            wait_for(lambda: daemons.felt_now(felt), "vibration")
            server.remove("speakers")
            status = daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        assert "no sink 'speakers'" in status.reason
        wait_for(lambda: not daemons.felt_now(felt), "silence")
        server.add_sink("speakers")
        with playing(server, "speakers", daemons.tone(60.0, 60.0)):
            wait_for(lambda: daemons.felt_now(felt), "vibration again", BACK_S[engine])
            daemon.wait_state(DaemonState.RUNNING)


def test_the_default_sink_is_removed_and_what_takes_its_place_is_felt(server, tmp_path):
    server.add_sink("speakers")
    server.choose_default("speakers")
    with (
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
        daemons.running(server) as daemon,
        # PulseAudio moves the player with its sink's end, PipeWire plays to the new default
        playing(server, "desktop", daemons.tone(60.0, 60.0)),
    ):
        daemon.wait(lambda s: s.tap.name == "speakers.monitor", "the tap")
        assert not daemons.felt_now(felt)
        gone_s = time.monotonic()
        server.remove("speakers")
        server.choose_default("desktop")  # a server may choose the device, which is never tapped
        wait_for(lambda: daemons.felt_now(felt), "vibration", 10.0)
        took_s = time.monotonic() - gone_s
        daemon.wait(lambda s: s.tap.name == "desktop.monitor", "the new tap")
    assert took_s < BACK_S["python"]


@pytest.mark.parametrize("sink", ["haptic", "desktop"])
def test_a_suspended_sink_stops_the_vibration_and_it_goes_on_afterwards(server, sink, tmp_path):
    if server.kind == "pipewire":
        pytest.skip("PipeWire resumes a sink that is played to")
    with daemons.vibrating(server, tmp_path, daemons.tone(60.0, 60.0)) as (daemon, felt):
        server.pactl("suspend-sink", sink, "1")
        frames = len(felt())
        wait_seconds(3.0)
        if sink == "desktop":
            assert not daemons.felt_now(felt)
        else:
            assert len(felt()) - frames < 24_000  # its monitor stood, too
        resumed = len(felt())
        server.pactl("suspend-sink", sink, "0")
        limit_s = BACK_S["python"]
        wait_for(
            lambda: np.abs(felt()[resumed:]).max(initial=0.0) > daemons.FELT, "vibration", limit_s
        )
        daemon.wait_state(DaemonState.RUNNING)
        wait_for(lambda: daemons.felt_now(felt), "vibration that goes on")
        loudest = float(np.abs(felt()[resumed:]).max())
    assert loudest <= 1.0


def test_a_test_tone_whose_device_vanishes_ends_and_says_so(server):
    command = [*daemons.CUSHION, "test-tone", "--device", "haptic", "--seconds", "20"]
    with daemons.program(daemons.environment(server), *command, stderr=subprocess.PIPE) as process:
        assert "60 Hz" in process.stdout.readline()
        server.remove("haptic")
        assert process.wait(10.0) == 4
        assert "the device was lost" in process.stderr.read()


def test_a_killed_daemon_leaves_heat_and_dose_and_a_damaged_record_means_hot_coils(server, engine):
    record = Path(server.environment["XDG_STATE_HOME"]) / "cushion" / "actuators.json"
    protected = "--protection", "on"

    def recorded() -> Any:
        return json.loads(record.read_text())["actuators"]["haptic 0.0"]

    def knows_its_coil(status: Status) -> bool:
        return bool(status.exposure and status.protection and status.protection.coil_c)

    with playing(server, "desktop", daemons.tone(60.0, 120.0)):
        with daemons.running(server, *protected, engine=engine) as daemon:
            seen: Any = daemon.wait(lambda s: s.exposure and s.exposure.a8_m_s2, "a dose")
            assert engine == "native" or seen.protection.coil_c == pytest.approx(20.0, abs=1.0)
            assert not seen.warnings
            wait_for(record.exists, "the record")
            wait_for(lambda: recorded()["dose"]["squares"], "a recorded dose", 15.0)
            daemon.process.kill()
        left = recorded() | {"coil_c": 110.0, "magnet_c": 60.0}
        known = json.loads(record.read_text())
        known["actuators"]["haptic 0.0"] = left
        record.write_text(json.dumps(known))
        with daemons.running(server, *protected, engine=engine) as daemon:
            seen = daemon.wait(knows_its_coil, "protection")
            assert 80.0 < seen.protection.coil_c < 120.0
            assert seen.exposure.a8_m_s2 >= (left["dose"]["squares"] / 28_800.0) ** 0.5
            assert not any("coils count" in warning for warning in seen.warnings)
        record.write_text("{")
        with daemons.running(server, *protected, engine=engine) as daemon:
            seen = daemon.wait(knows_its_coil, "protection")
            assert seen.protection.coil_c > 90.0
            assert sum("damaged" in warning for warning in seen.warnings) == 1


TONE_HZ = 110.0


def test_two_actuators_are_felt_where_they_are_wired_and_as_strong_as_asked(server, tmp_path):
    path, named = daemons.configured(tmp_path, TWO_SHAKERS.replace("[1]", "[2]"))
    line = refused(daemons.cushion(server, "run", "--device", "haptic", *named), 3)
    assert "actuator 2 wants channel 2, but the sink 'haptic' has no such channel" in line

    path.write_text(TWO_SHAKERS + 'polarity = "inverted"\ngain_db = -6.0206\n')
    with (
        playing(server, "desktop", daemons.tone(TONE_HZ, 60.0)) as player,
        daemons.running(server, *named) as daemon,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):

        def now() -> Float32Array:
            return felt()[-RATE_HZ // 10 :]

        def peaks() -> list[float]:
            last = now()
            return [float(peak) for peak in np.abs(last).max(axis=0)] if len(last) else [0.0, 0.0]

        # The same sound left and right: one is half of the other, upside down, sample by sample.
        wait_for(lambda: min(peaks()) > daemons.FELT, "vibration on both", 15.0)
        last = now()
        np.testing.assert_allclose(last[:, 1], -0.5 * last[:, 0], atol=1e-6)  # float32 of below 1
        status = daemon.wait(lambda s: s.actuators[1].level.peak_dbfs > -60.0, "levels")
        assert [actuator.channels for actuator in status.actuators] == [("0",), ("1",)]

        streams = connections(server, "sink-inputs")
        path.write_text(TWO_SHAKERS.translate({ord("0"): "1", ord("1"): "0"}))
        assert "changed: the actuators" in reload(daemon)
        wait_for(lambda: abs(peaks()[0] - peaks()[1]) < 0.02 * peaks()[1], "both as strong", 5.0)
        assert connections(server, "sink-inputs") == streams

        # Left alone, which is wired to the second channel by now.
        os.kill(player, signal.SIGTERM)
        left_only = daemons.tone(TONE_HZ, 60.0) * np.array([1.0, 0.0], np.float32)
        with playing(server, "desktop", left_only):
            wait_for(
                lambda: peaks()[1] > daemons.FELT > 1e-3 * daemons.FELT > peaks()[0],
                "the left one",
                15.0,
            )

"""`cushion run` and its config: what SIGHUP changes, and what it leaves alone."""

import os
import re
import shutil
import signal
import socket
import time
from contextlib import suppress
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.state import Cause, DaemonState
from device.units import Float32Array
from tests.servers import daemons
from tests.servers.listening import RATE_HZ, level_db, more, noise, playing, recording, wait_for
from tools.sound_server import SoundServer

ATTEMPTS = 30
WANTED = 3
"""So many have to be as they should; what disturbs the others is a shared machine, which holds up
whoever it likes now and then. A mistake would disturb all of them."""

TONE_HZ = 110.0


@pytest.fixture
def config(tmp_path):
    def write(*lines):
        path, new = tmp_path / "config.toml", tmp_path / "config.new"
        new.write_text("\n".join(('device = "haptic"', *lines, "")))
        return new.replace(path)  # whole, whenever it is read

    return write


@pytest.fixture
def plays(server, config, tmp_path):
    def begin(*lines, hz=TONE_HZ, **options):
        named = ("--config", str(config(*lines)))
        return daemons.vibrating(
            server, tmp_path, daemons.tone(hz, 120.0), *named, device=None, **options
        )

    return begin


def reload(daemon: daemons.Daemon) -> str:
    """Let it read its config again; what it says to that."""
    before = len(daemon.stderr)
    daemon.process.send_signal(signal.SIGHUP)

    def said() -> str:
        lines = daemon.stderr[before:].splitlines()
        return next((line for line in lines if "config " in line), "")

    return wait_for(said, "an answer to SIGHUP", 5.0)


@pytest.mark.parametrize(
    ("key", "value", "what", "step_db"),
    [("gain_db", -20, "the level", -20.0), ("offset_ms", 120, "the offset", 0.0)],
)
def test_another_level_or_offset_is_felt_soon_and_gapless(plays, config, key, value, what, step_db):
    with plays() as (daemon, felt):
        daemon.wait(lambda s: s.delay_line.state == "locked", "a lock", 30.0)
        took: list[float] = []
        for turn in range(ATTEMPTS):
            if len(took) == WANTED:
                break
            daemon.wait_state(DaemonState.RUNNING)
            was_db = level_db(more(felt, 0.3))
            steady = daemons.longest_silence(more(felt, 0.3))
            began = len(felt())
            config(f"{key} = {0 if turn % 2 else value}")
            assert f"changed: {what}" in reload(daemon)
            more(felt, 0.6)
            change = felt()[began:]
            wanted_db = was_db + (-step_db if turn % 2 else step_db)
            windows = np.lib.stride_tricks.sliding_window_view(change, RATE_HZ // 20, axis=0)
            there = [abs(level_db(one) - wanted_db) < 3.0 for one in windows[:: RATE_HZ // 100]]
            if there[-1] and daemons.longest_silence(change) <= max(steady, 2):
                took.append(0.01 * (len(there) - [*reversed(there), False].index(False)))
    assert len(took) == WANTED
    assert sorted(took)[(len(took) - 1) // 2] < 0.3


def test_another_parameter_acts_while_the_streams_stay_and_another_form_too(server, plays, config):
    with plays(hz=400.0) as (daemon, felt):
        before = daemons.pitch_hz(more(felt, 0.5))
        streams = connections(server, "sink-inputs")
        config("[transform]", "vibration_top_hz = 120")
        assert "the transform" in reload(daemon)
        wait_for(
            lambda: 1.0 < daemons.pitch_hz(felt()[-RATE_HZ // 4 :]) < before - 10.0, "a fall", 3.0
        )
        assert connections(server, "sink-inputs") == streams
        config("[transform]", 'channels = "each"')
        assert "the effects" in reload(daemon)
        wait_for(lambda: not daemons.felt_now(felt), "an end")
        wait_for(lambda: daemons.felt_now(felt), "vibration again", 15.0)
        assert daemon.wait_state(DaemonState.RUNNING).warnings == ()


def volume_of(server: SoundServer, sink: str) -> tuple[float, bool]:
    told = server.pactl("get-sink-volume", sink)
    level = re.search(r"(-?[\d.]+|-inf) dB", told)
    assert level, told
    return float(level[1]), server.pactl("get-sink-mute", sink).split()[-1] == "yes"


def test_the_device_s_own_volume_is_set_as_asked_and_left_alone_otherwise(server, config):
    def is_now(level_db: float, muted: bool = False) -> bool:
        now_db, is_muted = volume_of(server, "haptic")
        return abs(now_db - level_db) < 0.02 and is_muted == muted

    server.pactl("set-sink-volume", "haptic", "-30dB")
    server.pactl("set-sink-mute", "haptic", "1")
    before, path = volume_of(server, "desktop"), config()
    with (
        playing(server, "desktop", daemons.tone(TONE_HZ, 60.0)),
        daemons.running(server, "--config", str(path), device=None) as daemon,
    ):
        daemon.wait_state(DaemonState.RUNNING)
        assert is_now(-30.0, muted=True)
        streams = connections(server, "sink-inputs")
        config("device_volume_db = -12.5")
        assert "the device's volume" in reload(daemon)
        wait_for(lambda: is_now(-12.5), "another volume")
        server.pactl("set-sink-volume", "haptic", "-7.5dB")  # on top of what is set
        config("device_volume_db = -12.5", "offset_ms = 1")
        reload(daemon)
        assert is_now(-20.0)  # set by somebody while it plays: theirs
        assert connections(server, "sink-inputs") == streams
    with daemons.running(server, "--device-volume-db", "0") as daemon:
        daemon.wait_state(DaemonState.RUNNING)
        assert is_now(0.0)
    assert volume_of(server, "desktop") == before


def test_a_config_with_mistakes_changes_nothing_and_is_told(plays, config, tmp_path):
    with plays("gain_db = 0") as (daemon, felt):
        loud = level_db(more(felt, 0.5))
        for _ in range(2):  # told each time
            config("gain_db = -20", "offset_ms = 5000", "block_frames = 3")
            said = reload(daemon)
            assert "line 3: offset_ms = 5000 is out of range" in said
            assert "and 1 more" in said
        status = daemon.wait(lambda s: any("offset_ms" in w for w in s.warnings), "a warning")
        assert status.state is DaemonState.RUNNING
        assert abs(level_db(more(felt, 0.5)) - loud) < 3.0
        (tmp_path / "config.toml").unlink()
        assert "cannot be read" in reload(daemon)
        config("gain_db = 0")
        assert "changed: nothing" in reload(daemon)
        daemon.wait(lambda s: not any("config" in w for w in s.warnings), "no warning")
        config('tap = "scene:demo"')
        assert "cannot become 'scene:demo'" in reload(daemon)
        assert daemon.wait_state(DaemonState.RUNNING).tap.name == "desktop.monitor"


def test_another_device_has_the_vibration_and_the_first_one_no_more(server, plays, tmp_path):
    server.add_sink("seat")
    with (
        plays() as (daemon, first),
        recording(server, "seat.monitor", tmp_path / "second") as second,
        recording(server, "desktop.monitor", tmp_path / "sound") as sound,
    ):
        assert not second().any()
        taps = connections(server, "source-outputs")
        (tmp_path / "config.toml").write_text('device = "seat"\n')
        assert "changed: the device" in reload(daemon)
        wait_for(lambda: daemons.felt_now(second), "vibration on the other", 10.0)
        wait_for(lambda: not first()[-RATE_HZ // 10 :].any(), "silence on the first", 5.0)
        assert not more(first, 0.5).any()
        assert connections(server, "source-outputs") == taps
        assert abs(daemons.pitch_hz(more(sound, 0.5)) - TONE_HZ) < 2.0
        status = daemon.wait_state(DaemonState.RUNNING)
        assert (status.device.name, status.device.address) == ("seat", "sink:seat")
        assert "device sink:seat" in daemons.cushion(server, "run", "--device", "haptic").stderr


def test_another_tap_is_felt_and_the_output_goes_on(server, plays, config):
    server.add_sink("speakers")
    with playing(server, "speakers", daemons.tone(400.0, 120.0)), plays() as (daemon, felt):
        before = daemons.pitch_hz(more(felt, 0.5))
        streams = connections(server, "sink-inputs")
        config('tap = "sink:speakers"')
        assert "changed: the tap" in reload(daemon)
        status = daemon.wait(lambda s: s.tap.name == "speakers.monitor", "the other tap")
        assert status.tap.address == "sink:speakers"
        wait_for(lambda: daemons.pitch_hz(felt()[-RATE_HZ // 4 :]) > before + 20.0, "its tone", 3.0)
        assert connections(server, "sink-inputs") == streams
        assert not daemon.wait_state(DaemonState.RUNNING).recoveries[Cause.DEFAULT_CHANGED]


def bursts(seconds: float) -> Float32Array:
    """Noise that comes and goes without a period: a delay has one place where it fits."""
    generator = np.random.default_rng(5)
    sound = noise(seconds, 3) - np.float32(0.275)
    edges = (np.cumsum(generator.uniform(0.1, 0.4, int(seconds * 10))) * RATE_HZ).astype(int)
    for start, end in zip(edges[::2], edges[1::2], strict=False):
        sound[start:end] = 0.0
    return sound


def test_another_offset_moves_the_delay_by_that_much(server, config, tmp_path):
    path = config()
    with (
        playing(server, "desktop", bursts(120.0)),
        daemons.running(server, "--config", str(path), device=None) as daemon,
        recording(server, "desktop.monitor", tmp_path / "sound") as sound,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):

        def lag_ms() -> float:
            """By how much the vibration follows the sound, give or take the recordings' start."""
            ends = len(sound()), len(felt())
            more(felt, 4.0)
            wait_for(lambda: len(sound()) >= ends[0] + 4 * RATE_HZ, "as much sound")
            heard = daemons.envelope(sound()[ends[0] : ends[0] + 3 * RATE_HZ, 0])
            whole = daemons.envelope(felt()[: ends[1] + 4 * RATE_HZ, 0])
            near = max(0, ends[0] // 48 - 1_000)
            return near + daemons.best_lag(whole[near:], heard - heard.mean()) - ends[0] / 48.0

        wait_for(lambda: daemons.felt_now(felt), "vibration")
        daemon.wait(lambda s: s.delay_line.state == "locked", "a lock", 30.0)
        lags, targets = [], []
        for turn in range(3):
            if turn:
                config(f"offset_ms = {150 if turn % 2 else 0}")
                assert "changed: the offset" in reload(daemon)
            lags.append(lag_ms())
            targets.append(daemon.wait_state(DaemonState.RUNNING).delay_line.target_ms)
    moved = np.diff(lags) * (1, -1)
    provided = np.diff(targets) * (1, -1)
    # lateness that is provided for may change meanwhile, and what is recorded may have holes
    assert abs(np.mean(moved) - 150.0) < 40.0
    assert abs(np.median(provided) - 150.0) < 20.0


UNPLACED = str(2**32 - 1)  # PA_INVALID_INDEX: a stream is on no device


def connections(server: SoundServer, what: str) -> list[list[str]]:
    """What every stream is connected as, and to where: the same until it is opened anew.

    Its own number is not: ALSA has the server make another one when frames ran out.
    """

    def listed() -> list[list[str]]:
        # PulseAudio lists its streams in any order
        lines = server.pactl("list", "short", what).splitlines()
        return sorted(line.split()[1:3] for line in lines)

    # on PipeWire a stream that has just played may not have got its place yet
    wait_for(lambda: UNPLACED not in chain.from_iterable(listed()), "a place for each stream")
    return listed()


@pytest.mark.parametrize("frames", [128, 256, 1024])
def test_blocks_of_other_lengths_carry_the_vibration(plays, config, frames):
    with plays(f"block_frames = {frames}") as (daemon, felt):
        status = daemon.wait_ready()
        # one and a half of the tap's, and one of the output's
        assert status.delay_line.target_ms > 2.5e3 * frames / RATE_HZ
        felt_before = level_db(more(felt, 0.5))
        config("block_frames = 512")
        assert "which reopens both streams" in reload(daemon)
        daemon.wait(
            lambda s: (
                s.state is DaemonState.RUNNING
                and s.delay_line.delay_ms > 0.0
                and s.delay_line.target_ms != status.delay_line.target_ms
            ),
            "another delay",
        )
        wait_for(lambda: abs(level_db(felt()[-RATE_HZ // 4 :]) - felt_before) < 3.0, "its level")
    assert "Traceback" not in daemon.stderr


def test_fifty_signals_in_a_row_do_no_harm(server, plays, config):
    with plays("gain_db = 0") as (daemon, felt):
        loud = level_db(more(felt, 0.5))
        threads = len(list(Path(f"/proc/{daemon.process.pid}/task").iterdir()))
        streams = connections(server, "sink-inputs")
        for turn in range(50):
            gain_db = -20 if turn % 2 else 0
            config(f"gain_db = {gain_db}", "[transform]", f"partials_max = {turn + 1}")
            daemon.process.send_signal(signal.SIGHUP)
        config("gain_db = -10")
        assert "config reloaded" in reload(daemon)
        wait_for(
            lambda: abs(level_db(felt()[-RATE_HZ // 4 :]) - loud + 10.0) < 3.0,
            "the last level",
            5.0,
        )
        daemon.wait_state(DaemonState.RUNNING)
        assert connections(server, "sink-inputs") == streams
        assert len(list(Path(f"/proc/{daemon.process.pid}/task").iterdir())) <= threads + 1
        assert daemon.end(signal.SIGINT) == 130
    assert "Traceback" not in daemon.stderr


def test_systemd_is_told_of_the_start_and_of_every_reload(server, config, tmp_path):
    path = config()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        address = str(server.folder / "notify")
        manager.bind(address)
        manager.settimeout(5.0)
        variables = {"NOTIFY_SOCKET": address}

        def messages(last: str) -> list[str]:
            """What came until a message that begins so."""
            found = [""]
            while not found[-1].startswith(last):
                found.append(manager.recv(4096).decode())
            return found[1:]

        with daemons.running(
            server, "--config", str(path), device=None, ready=False, variables=variables
        ) as daemon:
            messages("READY=1")
            before_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1_000
            for text in ("gain_db = -3", "gain_db = 3"):  # the second one is a mistake
                config(text)
                reload(daemon)
                (began,) = messages("RELOADING=1")[-1:]
                found = re.fullmatch(r"RELOADING=1\nMONOTONIC_USEC=(\d+)", began)
                assert found
                now_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) / 1e3
                assert before_us <= int(found[1]) <= now_us
                messages("READY=1")
            daemon.process.terminate()
            messages("STOPPING=1")


def schedulers(daemon: daemons.Daemon) -> list[int]:
    found = []
    for thread in Path(f"/proc/{daemon.process.pid}/task").iterdir():
        with suppress(OSError):
            found.append(os.sched_getscheduler(int(thread.name)) & ~os.SCHED_RESET_ON_FORK)
    return found


def test_the_audio_threads_are_real_time_until_the_config_says_no(plays, config):
    with plays() as (daemon, felt):
        status = daemon.wait_state(DaemonState.RUNNING)
        if any("real-time" in warning for warning in status.warnings):
            pytest.skip("this machine grants no real-time priority")
        assert schedulers(daemon).count(os.SCHED_RR) == 2
        config("realtime = false")
        reload(daemon)
        wait_for(lambda: os.SCHED_RR not in schedulers(daemon), "threads like others")
        config("block_frames = 256")
        reload(daemon)
        wait_for(lambda: schedulers(daemon).count(os.SCHED_RR) == 2, "priority again")
        config('tap = "app:Player"')  # the thread that captures it is an audio thread, too
        assert "changed: the tap" in reload(daemon)
        daemon.wait(
            lambda s: s.tap.address == "app:Player" and s.levels.vibration.peak_dbfs > -60.0,
            "the application",
        )
        wait_for(lambda: schedulers(daemon).count(os.SCHED_RR) == 2, "two audio threads")
        config()
        assert "changed: the tap" in reload(daemon)
        daemon.wait(lambda s: s.tap.name == "desktop.monitor", "the monitor")
        wait_for(lambda: daemons.felt_now(felt), "vibration again")


@pytest.mark.skipif(
    shutil.which("setpriv") is None or os.geteuid() != 0, reason="no privileges to give up"
)
def test_without_priority_it_plays_all_the_same_and_says_once_what_to_do(plays, config, engine):
    without = ("prlimit", "--rtprio=0:0", "setpriv", "--bounding-set=-sys_nice")
    with plays(within=(*without, "--inh-caps=-sys_nice"), engine=engine) as (daemon, _):
        (warning,) = daemon.wait(lambda s: s.warnings, "a warning").warnings
        assert "/etc/security/limits.d/cushion.conf" in warning
        assert os.SCHED_RR not in schedulers(daemon)
        wait_for(lambda: warning in daemon.stderr, "the same on stderr")
        config("realtime = false")
        reload(daemon)
        daemon.wait(lambda s: not s.warnings, "no warning")
    assert daemon.stderr.count("real-time") == 1


def test_options_win_over_the_config_also_after_it_is_read_again(server, config):
    path = config("offset_ms = 20")
    path.write_text('device = "nowhere"\noffset_ms = 20\n')
    with (
        playing(server, "desktop", daemons.tone(TONE_HZ, 60.0)),
        daemons.running(server, "--config", str(path), "--offset-ms", "50") as daemon,
    ):
        assert daemon.wait_ready().latency.offset_ms == 50.0
        path.write_text('device = "elsewhere"\noffset_ms = 30\ngain_db = -1\n')
        assert "changed: the level" in reload(daemon)
        status = daemon.wait_ready()
    assert (status.latency.offset_ms, status.device.name) == (50.0, "haptic")

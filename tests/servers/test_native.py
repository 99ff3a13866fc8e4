"""`cushion run` with the native engine: inside PipeWire's graph, through every fault."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.state import Cause, DaemonState
from device.units import Float32Array
from tests.servers.conftest import started
from tests.servers.daemons import (
    FELT,
    Daemon,
    cpu_percent,
    cushion,
    felt_now,
    pitch_hz,
    recovered,
    running,
    tone,
)
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tests.servers.witness import check_step, witness_tone
from tools.sound_server import SoundServer

pytestmark = [pytest.mark.servers, pytest.mark.calm]

BACK_S = 1.0
"""Within this the vibration is back once a fault is over."""


@pytest.fixture
def pipewire(monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    yield from started("pipewire", monkeypatch)


@pytest.fixture
def pulse(monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    yield from started("pulse", monkeypatch)


def engine_process(daemon: Daemon) -> int:
    return daemon.wait(lambda status: status.engine_pid, "the native engine").engine_pid


def is_alive(process_id: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def back_within(felt: Callable[[], Float32Array], since_s: float, what: str) -> float:
    wait_for(lambda: felt_now(felt), f"vibration after {what}")
    took_s = time.monotonic() - since_s
    print(f"native: felt {took_s:.2f} s after {what}")
    assert took_s < BACK_S
    return took_s


def wait_for_more(felt: Callable[[], Float32Array], seconds: float) -> None:
    """Wait until a recording is longer by so many seconds."""
    frames = len(felt()) + int(seconds * RATE_HZ)
    wait_for(lambda: len(felt()) > frames, f"{seconds:g} s more", 10.0 + 2.0 * seconds)


def wait_until_felt(felt: Callable[[], Float32Array]) -> None:
    wait_for(lambda: felt_now(felt), "vibration")


def wait_for_engine(daemon: Daemon, engine: str) -> None:
    daemon.wait(lambda status: status.engine == engine, f"the {engine} engine")


def links_of(server: SoundServer) -> str:
    """All links of the graph; the player itself may follow the default sink."""
    return subprocess.run(
        ["pw-link", "--links"], env=server.environment, capture_output=True, text=True, check=True
    ).stdout


# ------------------------------------------------------------------------------------ which engine


def test_auto_takes_the_native_engine_on_pipewire_and_says_so(pipewire: SoundServer) -> None:
    with running(pipewire, engine=None) as daemon:
        status = daemon.wait_ready()
        shown = cushion(pipewire, "status")
    assert (status.engine, status.engine_reason) == ("native", "")
    assert daemon.stderr.count("the native engine plays") == 1
    assert status.latency.total_ms < 12.0
    assert "engine" in shown.stdout
    assert "native" in shown.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--engine", "python"), "engine = 'python'"),
        (("--drop-in",), "drop_in is on"),
    ],
)
def test_the_status_says_why_the_python_engine_plays(
    pipewire: SoundServer, arguments: tuple[str, ...], reason: str
) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0), name="player"),
        running(pipewire, *arguments, engine=None) as daemon,
    ):
        status = daemon.wait_ready()
    assert (status.engine, status.engine_reason) == ("python", reason)


def test_on_pulseaudio_auto_takes_the_python_engine_and_native_ends_with_3(
    pulse: SoundServer,
) -> None:
    with running(pulse, engine=None) as daemon:
        status = daemon.wait_ready()
    assert (status.engine, status.engine_reason) == ("python", "the sound server is PulseAudio")
    refused = cushion(pulse, "run", "--device", "haptic", "--engine", "native")
    assert refused.returncode == 3
    assert "the sound server is PulseAudio" in refused.stderr


@pytest.mark.parametrize("program", ["pipewire", "pw-dump", "pw-cli"])
def test_without_a_program_of_pipewire_auto_says_so_and_native_ends_with_3(
    pipewire: SoundServer, program: str, tmp_path: Path
) -> None:
    for folder in os.environ["PATH"].split(":"):
        for path in Path(folder).iterdir() if Path(folder).is_dir() else ():
            if path.name != program and not (tmp_path / path.name).exists():
                (tmp_path / path.name).symlink_to(path)
    without = {"PATH": str(tmp_path)}
    with running(pipewire, engine=None, variables=without) as daemon:
        status = daemon.wait_ready()
    assert status.engine == "python"
    assert f"the program {program} is missing" in status.engine_reason
    with running(pipewire, engine="native", ready=False, variables=without) as daemon:
        assert daemon.wait_exit() == 3
    assert f"the program {program} is missing" in daemon.stderr
    assert "Traceback" not in daemon.stderr


# ------------------------------------------------------------------------------------ what is felt


def test_each_actuator_plays_its_own_side_level_and_polarity(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    config = tmp_path / "config.toml"
    config.write_text(
        '[[actuator]]\nchannels = [0]\nsource = "left"\n'
        '[[actuator]]\nchannels = [1]\nsource = "mix"\ngain_db = -6.0\npolarity = "inverted"\n'
    )
    sound = tone(60.0, 6.0)
    sound[:, 1] = 0.0
    # in `paper`, vibration is proportional to sound
    options = ("--config", str(config), "--profile", "paper")
    with (
        running(pipewire, *options, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        playing(pipewire, "desktop", sound),
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        wait_for(lambda: len(felt()) > 3 * RATE_HZ, "three seconds")
        status = daemon.wait(lambda s: len(s.actuators) == 2, "two actuators")
        got = felt()[-RATE_HZ:].astype(np.float64)
    left, mix = got[:, 0], got[:, 1]
    assert pitch_hz(felt()[-RATE_HZ:]) > 0.0
    ratio = float(left @ mix / (left @ left))
    # half of the sound in the mix, at -6 dB, turned around
    assert ratio == pytest.approx(-0.25, abs=0.02)
    assert status.actuators[0].level.peak_dbfs > status.actuators[1].level.peak_dbfs + 10.0


def test_only_the_chosen_application_is_felt_and_each_of_its_streams(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with (
        playing(pipewire, "desktop", tone(200.0, 60.0), name="other"),
        running(pipewire, "--tap", "app:player", engine=None, ready=False) as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for_engine(daemon, "native")
        wait_for_more(felt, 1.0)
        assert not felt().any()
        since_s = time.monotonic()
        with playing(pipewire, "desktop", tone(60.0, 60.0), name="player"):
            back_within(felt, since_s, "the application began")
            wait_for_more(felt, 1.0)
            once_hz = pitch_hz(felt()[-RATE_HZ:])
            with playing(pipewire, "desktop", tone(800.0, 60.0), name="player"):
                wait_for(lambda: links_of(pipewire).count("|<- player:output_FL") == 4, "two links")
                wait_for_more(felt, 1.5)
                both = np.abs(np.fft.rfft(felt()[-RATE_HZ:, 0]))
        wait_for(lambda: not felt_now(felt), "silence")
    peaks = [hz for hz in range(20, 221) if both[hz] > 0.3 * both.max()]
    assert once_hz in peaks
    assert any(abs(hz - once_hz) > 10 for hz in peaks)


def test_leaving_an_application_out_is_not_told_as_a_change_of_the_default(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    config = tmp_path / "config.toml"
    config.write_text("gain_db = 0\n")
    with (
        playing(pipewire, "desktop", tone(110.0, 240.0), name="player"),
        running(pipewire, "--config", str(config), engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_until_felt(felt)
        config.write_text('[applications]\nexclude = ["player"]\n')
        daemon.process.send_signal(signal.SIGHUP)
        wait_for(lambda: not felt_now(felt), "silence")
        config.write_text("gain_db = 0\n")
        daemon.process.send_signal(signal.SIGHUP)
        wait_until_felt(felt)
        assert "default-changed" not in daemon.stderr


@pytest.mark.parametrize(
    ("before", "after", "least", "most", "offset_ms"),
    [
        # a steady tone also grows softer by 1 dB in ten seconds
        ("gain_db = 0\n", "gain_db = -12\n", 0.15, 0.35, 0.0),
        ("gain_db = -12\n", 'profile = "music"\n', 1.4, 10.0, 0.0),
        ('profile = "music"\n', "offset_ms = 40\n", 0.1, 10.0, 40.0),
    ],
    ids=["level", "profile", "delay"],
)
def test_a_new_level_profile_or_delay_takes_effect_without_a_gap_or_click(
    pipewire: SoundServer,
    before: str,
    after: str,
    least: float,
    most: float,
    offset_ms: float,
    tmp_path: Path,
) -> None:
    config = tmp_path / "config.toml"
    config.write_text(before)
    with (
        witness_tone(tmp_path) as witness,
        playing(pipewire, "desktop", tone(110.0, 240.0)),
        running(pipewire, "--config", str(config), engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        recording(pipewire, "desktop.monitor", tmp_path / "sound") as sound,
    ):
        wait_until_felt(felt)
        wait_for_more(felt, 1.0)
        level = np.abs(felt()[-RATE_HZ // 4 :]).max()
        heard = (felt, sound, witness)
        check_step(daemon, config, (before, after), heard, lambda which: None, silent_ms=0.0)
        change = np.abs(felt()[-RATE_HZ // 4 :]).max() / level
        print(f"the level is {change:.2f} times that of before")
        assert least < change < most
        daemon.wait(lambda status: status.latency.offset_ms == offset_ms, "the delay")


@pytest.mark.parametrize("engine", ["python", "native"])
def test_a_change_of_engine_costs_under_2_s_and_does_not_click(
    pipewire: SoundServer, engine: str, tmp_path: Path
) -> None:
    engines = ("native", "python") if engine == "python" else ("python", "native")
    config = tmp_path / "config.toml"
    config.write_text(f'engine = "{engines[0]}"\n')
    with (
        witness_tone(tmp_path) as witness,
        playing(pipewire, "desktop", tone(110.0, 240.0)),
        running(pipewire, "--config", str(config), engine=None) as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        recording(pipewire, "desktop.monitor", tmp_path / "sound") as sound,
    ):

        def settle(which: int) -> None:
            wait_for_engine(daemon, engines[which])
            if engines[which] == "python":
                daemon.wait(lambda status: status.engine_pid == 0, "the native engine's end")

        wait_until_felt(felt)
        texts = (f'engine = "{engines[0]}"\n', f'engine = "{engines[1]}"\n')
        check_step(daemon, config, texts, (felt, sound, witness), settle, silent_ms=2_000.0)


def test_it_idles_without_processor_time_and_wakes_at_once(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with running(pipewire, engine="native") as daemon:
        daemon.wait_state(DaemonState.IDLE)
        child = engine_process(daemon)
        used = cpu_percent(daemon.process.pid, child, seconds=10.0)
        print(f"native, idle: daemon {used[0]:.2f} %, its child {used[1]:.2f} % of a core")
        assert used[0] <= 0.5  # it answers to changes of the server once a second
        assert used[1] <= 0.1
        with (
            recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
            playing(pipewire, "desktop", tone(60.0, 10.0)),
        ):
            since_s = time.monotonic()
            back_within(felt, since_s, "idling")
            daemon.wait_state(DaemonState.RUNNING)


# ------------------------------------------------------------------------------------------ faults


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV])
def test_a_child_that_dies_or_hangs_is_started_again(
    pipewire: SoundServer, fault: signal.Signals, tmp_path: Path
) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        running(pipewire, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        child = engine_process(daemon)
        since_s = time.monotonic()
        os.kill(child, fault)
        daemon.wait(lambda status: status.engine_pid not in (0, child), "another child")
        back_within(felt, since_s, f"{fault.name} of the child")
        status = daemon.wait_state(DaemonState.RUNNING)
        assert recovered(status, Cause.ENGINE_LOST) == 1
        assert not is_alive(child)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ("truncate -s -8 $HAPTIC_CUSHION_DESIGN", "cut or too long"),
        ("printf c | dd of=$HAPTIC_CUSHION_DESIGN bs=1 seek=8 conv=notrunc", "another version"),
        ("printf x | dd of=$HAPTIC_CUSHION_DESIGN bs=1 seek=400 conv=notrunc", "damaged"),
    ],
)
def test_a_node_with_a_damaged_design_says_what_is_wrong_and_another_engine_takes_over(
    pipewire: SoundServer, tmp_path: Path, damage: str, reason: str
) -> None:
    program = tmp_path / "pipewire"
    program.write_text(f'#!/bin/sh\n{damage} 2>/dev/null\nexec {shutil.which("pipewire")} "$@"\n')
    program.chmod(0o755)
    variables = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        running(pipewire, engine=None, ready=False, variables=variables) as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration", 30.0)
        assert daemon.wait(lambda status: status.engine, "an engine").engine == "python"
    assert "cannot be used: " in daemon.stderr
    assert reason in daemon.stderr


@pytest.mark.parametrize("both", [False, True], ids=["daemon", "both"])
def test_a_killed_daemon_takes_its_child_along_and_the_next_one_plays(
    pipewire: SoundServer, both: bool, tmp_path: Path
) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        with running(pipewire, engine="native") as daemon:
            wait_for(lambda: felt_now(felt), "vibration")
            child = engine_process(daemon)
            daemon.process.kill()
            if both:
                os.kill(child, signal.SIGKILL)
            wait_for(lambda: not is_alive(child), "the child's end", 1.0)
            wait_for(lambda: not felt_now(felt), "silence", 1.0)
        with running(pipewire, engine="native"):
            wait_for(lambda: felt_now(felt), "vibration again")
        assert not list((pipewire.folder / "cushion").glob("haptic-cushion-*"))


def test_not_one_sample_is_elsewhere_when_the_device_vanishes_and_it_comes_back(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    pipewire.add_sink("other")
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        recording(pipewire, "other.monitor", tmp_path / "other") as other,
        running(pipewire, engine="native") as daemon,
    ):
        for _ in range(3):
            with recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt:
                wait_until_felt(felt)
            pipewire.remove("haptic")
            daemon.wait_state(DaemonState.WAITING_FOR_DEVICE)
            wait_for_more(other, 0.5)
            pipewire.add_sink("haptic")
            since_s = time.monotonic()
            with recording(pipewire, "haptic.monitor", tmp_path / "again") as felt:
                back_within(felt, since_s, "the device came back")
        status = daemon.wait_state(DaemonState.RUNNING)
        assert recovered(status, Cause.DEVICE_LOST) == 3
        assert not other().any()


def test_the_tap_follows_the_default_sink_and_never_the_device_or_a_microphone(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    pipewire.add_sink("speakers")
    pipewire.add_microphone("mic")
    with (
        running(pipewire, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        playing(pipewire, "mic-room", tone(80.0, 60.0)),
        playing(pipewire, "speakers", tone(60.0, 60.0)),
    ):
        wait_for(lambda: len(felt()) > RATE_HZ, "a second")
        assert not felt().any()
        since_s = time.monotonic()
        pipewire.choose_default("speakers")
        back_within(felt, since_s, "another default sink")
        pipewire.choose_default("haptic")
        status = daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        assert "would feed back" in status.reason
        wait_for(lambda: "haptic-cushion" not in links_of(pipewire), "no link", 3.0)
        pipewire.choose_default("speakers")
        wait_for(lambda: felt_now(felt), "vibration again")
        status = daemon.wait_state(DaemonState.RUNNING)
        assert recovered(status, Cause.DEFAULT_CHANGED) >= 1


def test_a_tapped_sink_that_vanishes_is_felt_again_when_it_is_back(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    pipewire.add_sink("speakers")
    with (
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        running(pipewire, "--tap", "sink:speakers", engine="native") as daemon,
    ):
        with playing(pipewire, "speakers", tone(60.0, 60.0)):
            wait_for(lambda: felt_now(felt), "vibration")
            pipewire.remove("speakers")
            daemon.wait_state(DaemonState.WAITING_FOR_SOUND_SOURCE)
        wait_for(lambda: not felt_now(felt), "silence")
        pipewire.add_sink("speakers")
        with playing(pipewire, "speakers", tone(60.0, 60.0)):
            back_within(felt, time.monotonic(), "the tapped sink played again")


def test_it_plays_again_after_the_server_was_killed(pipewire: SoundServer, tmp_path: Path) -> None:
    with running(pipewire, engine="native") as daemon:
        for _ in range(2):
            pipewire.kill()
            daemon.wait_state(DaemonState.WAITING_FOR_SERVER)
            pipewire.start()
            with (
                playing(pipewire, "desktop", tone(60.0, 30.0)),
                recording(pipewire, "desktop.monitor", tmp_path / "sound") as sound,
                recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
            ):
                wait_until_felt(sound)  # the server itself takes its time to link streams
                back_within(felt, time.monotonic(), "the server played again")
                status = daemon.wait_state(DaemonState.RUNNING)
        assert status.engine == "native"
        assert recovered(status, Cause.SERVER_LOST) == 2


def test_a_server_that_was_stopped_for_seconds_is_felt_again_at_once(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        running(pipewire, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_until_felt(felt)
        pipewire.pause()
        stopped_s = time.monotonic()
        wait_for(lambda: time.monotonic() - stopped_s > 2.0, "two seconds")
        frames = len(felt())
        pipewire.resume()
        since_s = time.monotonic()
        wait_for(lambda: len(felt()) > frames, "frames")
        back_within(felt, since_s, "the server went on")
        daemon.wait_state(DaemonState.RUNNING)


def test_a_stopped_daemon_does_not_stop_the_vibration(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        running(pipewire, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_until_felt(felt)
        daemon.process.send_signal(signal.SIGSTOP)
        wait_for_more(felt, 2.0)
        assert felt_now(felt)
        daemon.process.send_signal(signal.SIGCONT)
        daemon.wait_state(DaemonState.RUNNING)
        assert felt_now(felt)


@pytest.mark.parametrize("sink", ["haptic", "desktop"])
def test_a_suspended_sink_is_felt_again_when_it_is_resumed(
    pipewire: SoundServer, sink: str, tmp_path: Path
) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        running(pipewire, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_until_felt(felt)
        for _ in range(3):
            pipewire.pactl("suspend-sink", sink, "1")
            pipewire.pactl("suspend-sink", sink, "0")
            since_s = time.monotonic()
            # PipeWire leaves a recorder silent that a sink's suspend has interrupted
            with recording(pipewire, "haptic.monitor", tmp_path / "again") as again:
                wait_for(lambda: np.abs(again()[-480:]).max(axis=0, initial=0.0).min() > FELT, "it")
            took_s = time.monotonic() - since_s
            print(f"native: both channels felt {took_s:.2f} s after {sink} was resumed")
            assert took_s < BACK_S
        daemon.wait_state(DaemonState.RUNNING)


def test_a_device_of_another_server_is_left_to_the_python_engine(
    pipewire: SoundServer,
) -> None:
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        SoundServer("pipewire", Path(folder)) as other,
    ):
        other.add_sink("elsewhere")
        graph_of_this_one = {
            "PULSE_SERVER": other.address,
            "PIPEWIRE_RUNTIME_DIR": pipewire.environment["PIPEWIRE_RUNTIME_DIR"],
        }
        with running(
            pipewire, device="elsewhere", engine=None, ready=False, variables=graph_of_this_one
        ) as daemon:
            status = daemon.wait(lambda s: s.engine == "python", "the Python engine", 20.0)
    assert "has no node 'elsewhere': it is of another server" in status.engine_reason
    assert daemon.stderr.count("the python engine plays: PipeWire's graph has no node") == 1


def test_fifty_clients_do_not_disturb_it(pipewire: SoundServer, tmp_path: Path) -> None:
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        running(pipewire, engine="native") as daemon,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        child = engine_process(daemon)
        clients = [
            subprocess.Popen(
                ["pacat", "--playback", "--device=desktop", "/dev/zero", "--raw"],
                env=pipewire.environment,
                stdin=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            for _ in range(50)
        ]
        try:
            before = len(felt())
            wait_for(lambda: len(felt()) > before + 2 * RATE_HZ, "two seconds", 30.0)
        finally:
            for client in clients:
                client.kill()
            for client in clients:
                client.wait()
        wait_for(lambda: felt_now(felt), "vibration")
        assert engine_process(daemon) == child


def test_the_users_own_nodes_of_the_installed_chains_names_keep_their_links(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    own = ["pw-loopback", "--capture", "desktop", "--playback", "other"]
    pipewire.add_sink("other")
    with subprocess.Popen(
        [
            *own,
            "--capture-props=node.name=haptic-cushion.tap stream.capture.sink=true",
            "--playback-props=node.name=haptic-cushion.vibration",
        ],
        env=pipewire.environment,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as users:
        try:
            wanted = "haptic-cushion.vibration:output_FL"
            wait_for(lambda: wanted in links_of(pipewire), "the user's own links")
            with (
                playing(pipewire, "desktop", tone(60.0, 60.0)),
                running(pipewire, engine="native"),
                recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
            ):
                wait_until_felt(felt)
                assert wanted in links_of(pipewire)
            assert wanted in links_of(pipewire)
        finally:
            users.kill()


def test_a_second_daemon_is_refused_and_the_first_plays_on(pipewire: SoundServer) -> None:
    with running(pipewire, engine="native") as daemon:
        refused = cushion(pipewire, "run", "--device", "haptic", "--engine", "native")
        assert refused.returncode != 0
        assert "Traceback" not in refused.stderr
        assert daemon.wait_ready().engine == "native"


def test_seconds_are_wall_clock_time_also_while_nothing_plays(pipewire: SoundServer) -> None:
    with running(pipewire, "--seconds", "2", engine="native", ready=False) as daemon:
        daemon.wait_ready()
        began_s = time.monotonic()
        assert daemon.wait_exit(10.0) == 0
    assert 1.0 < time.monotonic() - began_s < 4.0

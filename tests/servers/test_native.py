"""`cushion run` with the native engine: inside PipeWire's graph, through every fault."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.state import Cause, DaemonState
from device.units import Float32Array
from tests.servers.daemons import (
    FELT,
    configured,
    cpu_percent,
    cushion,
    felt_now,
    links_of,
    pitch_hz,
    program,
    running,
    tone,
    vibrating,
)
from tests.servers.listening import (
    RATE_HZ,
    more,
    own_server,
    playing,
    recording,
    wait_for,
    wait_seconds,
)
from tests.servers.witness import check_step, witness_tone
from tests.support.commands import refused

pytestmark = [pytest.mark.servers, pytest.mark.calm]

BACK_S = 1.0  # within this the vibration is back once a fault is over


def is_alive(process_id: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def back_within(felt: Callable[[], Float32Array], since_s: float, what: str) -> None:
    wait_for(lambda: felt_now(felt), f"vibration after {what}")
    assert time.monotonic() - since_s < BACK_S


def test_auto_takes_the_native_engine_on_pipewire_and_says_so(pipewire):
    with running(pipewire, engine=None) as daemon:
        status, shown = daemon.wait_ready(), cushion(pipewire, "status")
    assert (status.engine, status.engine_reason) == ("native", "")
    assert daemon.stderr.count("the native engine plays") == 1
    assert status.latency.total_ms < 12.0
    assert "engine" in shown.stdout
    assert "native" in shown.stdout


def test_on_pulseaudio_auto_takes_the_python_engine_and_native_ends_with_3(pulse):
    with running(pulse, engine=None) as daemon:
        status = daemon.wait_ready()
    assert (status.engine, status.engine_reason) == ("python", "the sound server is PulseAudio")
    native = cushion(pulse, "run", "--device", "haptic", "--engine", "native")
    assert "the sound server is PulseAudio" in refused(native, 3)


@pytest.mark.parametrize("program", ["pipewire", "pw-dump", "pw-cli"])
def test_without_a_program_auto_says_so_and_native_ends_with_3(pipewire, program, tmp_path):
    for folder in os.environ["PATH"].split(":"):
        for path in Path(folder).iterdir() if Path(folder).is_dir() else ():
            if path.name != program and not (tmp_path / path.name).exists():
                (tmp_path / path.name).symlink_to(path)
    without = {"PATH": str(tmp_path)}
    with running(pipewire, engine=None, variables=without) as daemon:
        status = daemon.wait_ready()
    assert status.engine == "python"
    assert f"the program {program} is missing" in status.engine_reason
    told = cushion(pipewire, "run", "--device", "haptic", "--engine", "native", env=without)
    assert f"the program {program} is missing" in refused(told, 3)


def test_each_actuator_plays_its_own_side_level_and_polarity(pipewire, tmp_path):
    _, named = configured(
        tmp_path,
        '[[actuator]]\nchannels = [0]\nsource = "left"\n'
        '[[actuator]]\nchannels = [1]\nsource = "mix"\ngain_db = -6.0\npolarity = "inverted"\n',
    )
    sound = tone(60.0, 6.0)
    sound[:, 1] = 0.0
    with (
        # in `paper`, vibration is proportional to sound
        running(pipewire, *named, "--profile", "paper", engine="native") as daemon,
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


def test_leaving_an_application_out_is_not_told_as_a_change_of_the_default(pipewire, tmp_path):
    config, named = configured(tmp_path, "gain_db = 0\n")
    sound = tone(110.0, 240.0)
    with vibrating(pipewire, tmp_path, sound, *named, engine="native") as (daemon, felt):
        daemon.reload(config, '[applications]\nexclude = ["player"]\n')
        wait_for(lambda: not felt_now(felt), "silence")
        daemon.reload(config, "gain_db = 0\n")
        wait_for(lambda: felt_now(felt), "vibration")
        assert "default-changed" not in daemon.stderr


@contextmanager
def witnessed(server, folder, named, engine):
    """A daemon that vibrates, with what is felt, the played sound and a witness."""
    with (
        witness_tone(folder) as witness,
        vibrating(server, folder, tone(110.0, 240.0), *named, engine=engine) as (daemon, felt),
        recording(server, "desktop.monitor", folder / "sound") as sound,
    ):
        yield daemon, (felt, sound, witness)


def test_a_new_level_profile_or_delay_takes_effect(pipewire, tmp_path):
    config, named = configured(tmp_path, "gain_db = 0\n")
    sound = tone(110.0, 240.0)
    with vibrating(pipewire, tmp_path, sound, *named, engine="native") as (daemon, felt):
        # the least and the most change of the peak, and the delay then; no gap and no click:
        # tests/servers/test_live_changes.py
        for text, least, most, offset_ms in (
            ("gain_db = -12\n", 0.15, 0.35, 0.0),
            ('profile = "music"\n', 1.4, 10.0, 0.0),
            ("offset_ms = 40\n", 0.1, 10.0, 40.0),
        ):
            level = np.abs(more(felt, 1.0)[-RATE_HZ // 4 :]).max()
            daemon.reload(config, text)
            change = np.abs(more(felt, 1.5)[-RATE_HZ // 4 :]).max() / level
            assert least < change < most, text
            assert daemon.status().latency.offset_ms == offset_ms


@pytest.mark.parametrize("engine", ["python", "native"])
def test_a_change_of_engine_costs_under_2_s_and_does_not_click(pipewire, engine, tmp_path):
    engines = ("native", "python") if engine == "python" else ("python", "native")
    texts = (f'engine = "{engines[0]}"\n', f'engine = "{engines[1]}"\n')
    config, named = configured(tmp_path, texts[0])
    with witnessed(pipewire, tmp_path, named, engine=None) as (daemon, heard):

        def settle(which: int) -> None:
            daemon.wait(lambda status: status.engine == engines[which], "the engine")
            if engines[which] == "python":
                daemon.wait(lambda status: status.engine_pid == 0, "the native engine's end")

        check_step(daemon, config, texts, heard, settle, silent_ms=2_000.0)


def test_it_idles_without_processor_time_and_wakes_at_once(pipewire, tmp_path):
    with running(pipewire, engine="native") as daemon:
        daemon.wait_state(DaemonState.IDLE)
        used = cpu_percent(daemon.process.pid, daemon.engine_process(), seconds=10.0)
        assert used[0] <= 0.5  # it answers to changes of the server once a second
        assert used[1] <= 0.1
        with (
            recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
            playing(pipewire, "desktop", tone(60.0, 10.0)),
        ):
            back_within(felt, time.monotonic(), "idling")
            daemon.wait_state(DaemonState.RUNNING)


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV])
def test_a_child_that_dies_or_hangs_is_started_again(pipewire, fault, tmp_path):
    with vibrating(pipewire, tmp_path, tone(60.0, 60.0), engine="native") as (daemon, felt):
        child, since_s = daemon.engine_process(), time.monotonic()
        os.kill(child, fault)
        daemon.wait(lambda status: status.engine_pid not in (0, child), "another child")
        back_within(felt, since_s, f"{fault.name} of the child")
        status = daemon.wait_state(DaemonState.RUNNING)
        assert status.recoveries[Cause.ENGINE_LOST] == 1
        assert not is_alive(child)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ("truncate -s -8 $HAPTIC_CUSHION_DESIGN", "cut or too long"),
        ("printf c | dd of=$HAPTIC_CUSHION_DESIGN bs=1 seek=8 conv=notrunc", "another version"),
        ("printf x | dd of=$HAPTIC_CUSHION_DESIGN bs=1 seek=400 conv=notrunc", "damaged"),
    ],
)
def test_a_damaged_design_is_told_and_another_engine_takes_over(pipewire, tmp_path, damage, reason):
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
def test_a_killed_daemon_takes_its_child_along_and_the_next_one_plays(pipewire, both, tmp_path):
    with (
        playing(pipewire, "desktop", tone(60.0, 60.0)),
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        with running(pipewire, engine="native") as daemon:
            wait_for(lambda: felt_now(felt), "vibration")
            child = daemon.engine_process()
            daemon.process.kill()
            if both:
                os.kill(child, signal.SIGKILL)
            wait_for(lambda: not is_alive(child), "the child's end", 1.0)
            wait_for(lambda: not felt_now(felt), "silence", 1.0)
        with running(pipewire, engine="native"):
            wait_for(lambda: felt_now(felt), "vibration again")
        assert not list((pipewire.folder / "cushion").glob("haptic-cushion-*"))


def test_a_stopped_server_is_felt_again_at_once_and_a_stopped_daemon_all_along(pipewire, tmp_path):
    with vibrating(pipewire, tmp_path, tone(60.0, 60.0), engine="native") as (daemon, felt):
        daemon.process.send_signal(signal.SIGSTOP)
        more(felt, 2.0)
        assert felt_now(felt)
        daemon.process.send_signal(signal.SIGCONT)
        daemon.wait_state(DaemonState.RUNNING)
        assert felt_now(felt)
        pipewire.pause()
        wait_seconds(2.0)
        frames = len(felt())
        pipewire.resume()
        since_s = time.monotonic()
        wait_for(lambda: len(felt()) > frames, "frames")
        back_within(felt, since_s, "the server went on")
        daemon.wait_state(DaemonState.RUNNING)


@pytest.mark.parametrize("sink", ["haptic", "desktop"])
def test_a_suspended_sink_is_felt_again_when_it_is_resumed(pipewire, sink, tmp_path):
    with vibrating(pipewire, tmp_path, tone(60.0, 60.0), engine="native") as (daemon, _):
        for _ in range(3):
            pipewire.pactl("suspend-sink", sink, "1")
            pipewire.pactl("suspend-sink", sink, "0")
            since_s = time.monotonic()
            # PipeWire leaves a recorder silent that a sink's suspend has interrupted
            with recording(pipewire, "haptic.monitor", tmp_path / "again") as again:
                wait_for(lambda: np.abs(again()[-480:]).max(axis=0, initial=0.0).min() > FELT, "it")
            assert time.monotonic() - since_s < BACK_S
        daemon.wait_state(DaemonState.RUNNING)


def test_a_device_of_another_server_is_left_to_the_python_engine(pipewire):
    with own_server() as other:
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


def test_the_users_own_nodes_of_the_installed_chains_names_keep_their_links(pipewire, tmp_path):
    own = ("pw-loopback", "--capture", "desktop", "--playback", "other")
    capture = "--capture-props=node.name=haptic-cushion.tap stream.capture.sink=true"
    playback = "--playback-props=node.name=haptic-cushion.vibration"
    wanted = "haptic-cushion.vibration:output_FL"
    pipewire.add_sink("other")
    quiet = {"stdout": None, "stderr": subprocess.DEVNULL}
    with program(pipewire.environment, *own, capture, playback, **quiet):
        wait_for(lambda: wanted in links_of(pipewire), "the user's own links")
        with vibrating(pipewire, tmp_path, tone(60.0, 60.0), engine="native"):
            assert wanted in links_of(pipewire)
        assert wanted in links_of(pipewire)


def test_seconds_are_wall_clock_time_also_while_nothing_plays(pipewire):
    with running(pipewire, "--seconds", "2", engine="native", ready=False) as daemon:
        daemon.wait_ready()
        began_s = time.monotonic()
        assert daemon.wait_exit(10.0) == 0
    assert 1.0 < time.monotonic() - began_s < 4.0

"""The native engine on any graph: other rates and layouts, moved streams, volumes, fallback.

These tests run on PipeWire 0.3, 1.4 and 1.6 alike.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.state import DaemonState
from device.units import Float32Array
from tests.servers.conftest import started
from tests.servers.daemons import FELT, Daemon, felt_hz, felt_now, pitch_hz, running, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tools.churn import churned
from tools.live_latency.refusing import refusing_pw_cli
from tools.sound_server import MONO, SURROUND_5_1, SoundServer

pytestmark = [pytest.mark.servers]

BACK_S = 1.0
"""Within this the vibration is back after a change."""

LEVEL_DB = 0.5
"""Two equal levels differ by less."""

HEARD_HZ, OTHER_HZ = 110.0, 900.0
"""Two tones that vibrate at frequencies of their own."""


@pytest.fixture
def pipewire(monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    yield from started("pipewire", monkeypatch)


@contextmanager
def native(
    server: SoundServer, folder: Path, *arguments: str, variables: Mapping[str, str] = {}
) -> Iterator[tuple[Daemon, Callable[[], Float32Array]]]:
    """The native engine, and a recording of its vibration."""
    with (
        running(server, *arguments, engine="native", ready=False, variables=variables) as daemon,
        recording(server, "haptic.monitor", folder / "felt", stays=True) as felt,
    ):
        yield daemon, felt


def more(felt: Callable[[], Float32Array], seconds: float) -> Float32Array:
    """The next so many seconds of a recording."""
    begin = len(felt())
    frames = int(seconds * RATE_HZ)
    wait_for(lambda: len(felt()) >= begin + frames, f"{seconds:g} s more", 10.0 + 2.0 * seconds)
    return felt()[begin : begin + frames]


def felt_back(
    felt: Callable[[], Float32Array], what: str, limit_s: float = BACK_S, hz: float = HEARD_HZ
) -> None:
    """Wait for vibration of a tone; it must come within a second."""
    since_s, wanted_hz = time.monotonic(), felt_hz(hz)

    def is_back() -> bool:
        last = felt()[-RATE_HZ // 4 :]
        return felt_now(felt) and len(last) > 0 and abs(strongest_hz(last) - wanted_hz) < 4.0

    wait_for(is_back, f"vibration after {what}")
    took_s = time.monotonic() - since_s
    print(f"felt {took_s:.2f} s after {what}")
    # a quarter of a second of the tone must have come before its frequency is known
    assert took_s < limit_s + 0.25


def strongest_hz(frames: Float32Array) -> float:
    """The strongest frequency of a short part."""
    if not len(frames):
        return 0.0
    powers = np.abs(np.fft.rfft(frames[:, 0] * np.hanning(len(frames)), 4 * RATE_HZ))
    return float(np.argmax(powers)) / 4.0


def longest_silence_s(frames: Float32Array) -> float:
    """The longest part in which nothing is felt."""
    step = RATE_HZ // 200
    peaks = np.abs(frames[: len(frames) // step * step, 0]).reshape(-1, step).max(axis=1)
    longest = run = 0
    for peak in peaks:
        run = run + 1 if peak < FELT else 0
        longest = max(longest, run)
    return longest * step / RATE_HZ


def rms_db(frames: Float32Array) -> float:
    square = float(np.mean(np.square(frames, dtype=np.float64)))
    return float(10.0 * np.log10(max(square, 1e-20)))


def stream_named(server: SoundServer, name: str) -> str:
    """The index of the newest stream of an application."""

    def found() -> str:
        listed = server.pactl("list", "sink-inputs").split("Sink Input #")[1:]
        mine = [part.split()[0] for part in listed if f'application.name = "{name}"' in part]
        return mine[-1] if mine else ""

    return wait_for(found, f"a stream of {name}")


def links_from(server: SoundServer, player: str) -> set[str]:
    """The sinks that a program plays to."""
    shown = subprocess.run(
        ["pw-link", "--output", "--links"],
        env=server.environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found, mine = set(), False
    for line in shown.splitlines():
        if line.startswith(" "):
            node, _, port = line.rpartition("-> ")[2].partition(":")
            if mine and port.startswith("playback"):
                found.add(node.strip())
        else:
            mine = line.startswith(f"{player}:")
    return found


def move(server: SoundServer, stream: str, sink: str) -> None:
    """Move the stream `mover`; WirePlumber 0.4 leaves out a wish now and then."""

    def is_there() -> bool:
        if links_from(server, "mover") == {sink}:
            return True
        other = next(name for name in server.names("sinks") if name != sink)
        server.pactl("move-sink-input", stream, other)
        server.pactl("move-sink-input", stream, sink)
        with suppress(AssertionError):
            wait_for(lambda: links_from(server, "mover") == {sink}, "the move", 1.0)
        return links_from(server, "mover") == {sink}

    server.pactl("move-sink-input", stream, sink)
    with suppress(AssertionError):
        wait_for(lambda: links_from(server, "mover") == {sink}, "the move", 1.0)
    wait_for(is_there, f"the stream at {sink}")


# ---------------------------------------------------------------------------------- rates, layouts


def test_a_default_sink_of_44_1_khz_is_felt_at_its_rate(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    pipewire.add_sink("slow", rate_hz=44_100)
    pipewire.choose_default("slow")
    with (
        playing(pipewire, "slow", tone(HEARD_HZ, 60.0)),
        native(pipewire, tmp_path) as (
            daemon,
            felt,
        ),
    ):
        wait_for(lambda: felt_now(felt), "vibration", 20.0)
        more(felt, 0.5)
        # heard at 48 kHz it would be 3.5 Hz off; a cycle that is lost blurs the second by 1 Hz
        assert pitch_hz(more(felt, 1.0)) == pytest.approx(felt_hz(HEARD_HZ), abs=2.0)
        assert daemon.wait(lambda status: status.graph, "figures").state.value == "running"


def test_the_rate_of_the_graph_may_change_while_it_plays(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with (
        # as loud as a stream's programme is at first, which a louder one is only after minutes
        playing(pipewire, "desktop", tone(HEARD_HZ, 120.0, 0.06)),
        native(pipewire, tmp_path) as (daemon, felt),
    ):
        wait_for(lambda: felt_now(felt), "vibration", 20.0)
        more(felt, 0.5)
        levels_db = []
        for rate_hz in (44_100, 96_000, 0):
            pipewire.set_clock("force-rate", rate_hz)
            silent_s = longest_silence_s(more(felt, 2.5))
            print(f"silent for {silent_s:.2f} s after a forced rate of {rate_hz}")
            assert silent_s < BACK_S
            assert strongest_hz(more(felt, 0.5)) == pytest.approx(felt_hz(HEARD_HZ), abs=2.0)
            levels_db.append(rms_db(more(felt, 0.5)))
            status = daemon.wait(lambda status: status.graph, "the graph's rate")
            assert status.graph is not None
            if rate_hz:  # 0.3 leaves it as it is until the graph rests
                assert status.graph.samplerate == rate_hz
            assert status.graph.tap == "streams"
        assert max(levels_db) - min(levels_db) < 1.0


# ------------------------------------------------------------------------------------ what is felt


def test_of_two_programs_of_one_name_only_the_one_at_the_sink_is_felt(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    pipewire.add_sink("elsewhere")
    with (
        playing(pipewire, "elsewhere", tone(OTHER_HZ, 60.0, 0.9), name="twin"),
        native(pipewire, tmp_path) as (daemon, felt),
    ):
        daemon.wait(lambda status: status.engine == "native", "the native engine")
        assert not more(felt, 1.0).any()
        with playing(pipewire, "desktop", tone(HEARD_HZ, 60.0), name="twin"):
            wait_for(lambda: felt_now(felt), "vibration")
            more(felt, 0.5)
            part = more(felt, 1.0)
    powers = np.abs(np.fft.rfft(part[:, 0] * np.hanning(len(part)), RATE_HZ))
    other, heard = round(felt_hz(OTHER_HZ)), round(felt_hz(HEARD_HZ))
    near = powers[heard - 3 : heard + 4].max()
    assert powers[other - 3 : other + 4].max() < 0.02 * near


def test_a_stream_that_moves_away_is_not_felt_until_it_is_back(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    pipewire.add_sink("elsewhere")
    with (
        playing(pipewire, "desktop", tone(HEARD_HZ, 120.0), name="mover"),
        native(pipewire, tmp_path) as (_, felt),
    ):
        wait_for(lambda: felt_now(felt), "vibration", 20.0)
        stream = stream_named(pipewire, "mover")
        for _ in range(3):
            move(pipewire, stream, "elsewhere")
            wait_for(lambda: not felt_now(felt, 0.2), "silence")
            move(pipewire, stream, "desktop")
            felt_back(felt, "the stream came back")


# ----------------------------------------------------------------------------------------- volumes


@pytest.fixture
def refusing(tmp_path: Path) -> dict[str, str]:
    """Variables with a `pw-cli` that makes no link from the ports of streams."""
    return refusing_pw_cli(tmp_path)


def test_refused_links_lead_to_the_monitor_within_a_second_and_status_says_so(
    pipewire: SoundServer, refusing: dict[str, str], tmp_path: Path
) -> None:
    with native(pipewire, tmp_path, variables=refusing) as (daemon, felt):
        daemon.wait_ready()
        since_s = time.monotonic()
        with playing(pipewire, "desktop", tone(HEARD_HZ, 60.0)):
            wait_for(lambda: felt_now(felt), "vibration")
            took_s = time.monotonic() - since_s
            status = daemon.wait(
                lambda status: status.graph and status.graph.tap == "monitor", "the monitor"
            )
            shown = subprocess.run(["pw-link", "-l"], env=pipewire.environment, capture_output=True)
    print(f"felt {took_s:.2f} s after refused links")
    assert b"desktop:monitor_FL" in shown.stdout
    assert took_s < 1.5  # the player itself needs up to half a second
    assert status.graph is not None
    assert "does not make the links" in status.graph.tap_reason
    assert any("one cycle later" in warning for warning in status.warnings)


def test_volumes_and_mutes_count_alike_on_both_taps(
    pipewire: SoundServer, refusing: dict[str, str], tmp_path: Path
) -> None:
    found: list[list[float]] = []
    for variables in ({}, refusing):
        levels_db: list[float] = []
        with ExitStack() as stack:
            stack.enter_context(playing(pipewire, "desktop", tone(HEARD_HZ, 240.0), name="loud"))
            stream = stream_named(pipewire, "loud")
            _, felt = stack.enter_context(
                native(pipewire, tmp_path, "--profile", "paper", variables=variables)
            )
            wait_for(lambda felt=felt: felt_now(felt), "vibration", 20.0)  # type: ignore[misc]
            for what, one in (("sink", "desktop"), ("sink-input", stream)):
                for ask, on, off in (("volume", "50%", "100%"), ("mute", "1", "0")):
                    pipewire.pactl(f"set-{what}-{ask}", one, on)
                    more(felt, 1.0)
                    levels_db.append(rms_db(more(felt, 0.5)))
                    pipewire.pactl(f"set-{what}-{ask}", one, off)
                    more(felt, 1.0)
                    levels_db.append(rms_db(more(felt, 0.5)))
        found.append(levels_db)
    print("sink 50 %, 100 %, muted, not; stream 50 %, 100 %, muted, not:", *found, sep="\n")
    for streams_db, monitor_db in zip(*found, strict=True):
        assert streams_db == pytest.approx(monitor_db, abs=LEVEL_DB)
    half, full, muted, _, own_half, _, own_muted, _ = found[0]
    assert full - half == pytest.approx(18.06, abs=LEVEL_DB)  # 50 % by the cubic law
    assert full - own_half == pytest.approx(18.06, abs=LEVEL_DB)
    assert max(muted, own_muted) < -100.0


@pytest.mark.parametrize("layout", [MONO, SURROUND_5_1], ids=["mono", "5.1"])
def test_a_sink_of_any_layout_is_felt_as_its_monitor_would_be(
    pipewire: SoundServer, layout: str, refusing: dict[str, str], tmp_path: Path
) -> None:
    pipewire.add_sink("other", channel_map=layout)
    pipewire.choose_default("other")
    levels_db = []
    for variables in ({}, refusing):
        with (
            playing(pipewire, "other", tone(HEARD_HZ, 60.0)),
            native(pipewire, tmp_path, "--profile", "paper", variables=variables) as (_, felt),
        ):
            wait_for(lambda felt=felt: felt_now(felt), "vibration", 20.0)  # type: ignore[misc]
            more(felt, 1.0)
            levels_db.append(rms_db(more(felt, 0.5)))
    print("level by the streams and by the monitor:", levels_db)
    assert levels_db[0] == pytest.approx(levels_db[1], abs=LEVEL_DB)


# ------------------------------------------------------------------------------------------ faults


def test_an_engine_without_real_time_priority_says_how_to_get_it(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    dropped = ("prlimit", "--rtprio=0:0", "setpriv", "--bounding-set=-sys_nice")
    within = (*dropped, "--inh-caps=-sys_nice")
    if subprocess.run([*within, "true"], capture_output=True).returncode != 0:
        pytest.skip(f"{' '.join(within)} does not work here")
    with (
        playing(pipewire, "desktop", tone(HEARD_HZ, 60.0)),
        running(pipewire, engine="native", ready=False, within=within) as daemon,
    ):
        warned = daemon.wait(lambda status: status.warnings, "a warning").warnings
    assert "no real-time priority" in warned[0]
    assert "limits.d" in warned[0]


def test_wireplumber_may_be_restarted_while_the_engine_runs(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with running(pipewire, engine="native") as daemon:
        with (
            playing(pipewire, "desktop", tone(HEARD_HZ, 120.0)),
            recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        ):
            wait_for(lambda: felt_now(felt), "vibration", 20.0)
        # WirePlumber 0.4 links nobody while a stream is there that played before it started. These
        # two have ended; those of the engine must end by themselves.
        pipewire.restart_wireplumber()
        with (
            playing(pipewire, "desktop", tone(OTHER_HZ, 60.0), name="later"),
            recording(pipewire, "haptic.monitor", tmp_path / "again") as again,
        ):
            wait_for(lambda: links_from(pipewire, "later"), "WirePlumber")
            felt_back(again, "WirePlumber's restart", hz=OTHER_HZ)
            daemon.wait_state(DaemonState.RUNNING)
        assert daemon.process.poll() is None


def test_pipewire_may_be_restarted_while_it_plays(pipewire: SoundServer, tmp_path: Path) -> None:
    with ExitStack() as player, native(pipewire, tmp_path) as (daemon, felt):
        player.enter_context(playing(pipewire, "desktop", tone(HEARD_HZ, 120.0)))
        wait_for(lambda: felt_now(felt), "vibration", 20.0)
        pipewire.kill()
        pipewire.start()
        with (
            playing(pipewire, "desktop", tone(OTHER_HZ, 60.0), name="later"),
            recording(pipewire, "haptic.monitor", tmp_path / "again") as again,
        ):
            wait_for(lambda: links_from(pipewire, "later"), "the player's links")
            felt_back(again, "the server's restart", hz=OTHER_HZ)
        assert daemon.process.poll() is None


@pytest.mark.soak
def test_hundreds_of_nodes_and_streams_that_come_and_go_disturb_nothing(
    pipewire: SoundServer,
) -> None:
    found = churned(pipewire, 60.0)
    print(found)
    assert found.links_growth == 0
    assert found.memory_growth_kb < 1_024  # ten thousand objects that stay would be more
    assert found.cpu_percent < 5.0
    assert found.heard_gaps_ms <= 40.0  # two cycles: the players alone fill both cores
    assert found.felt_gaps_ms <= 0.01 * 60_000

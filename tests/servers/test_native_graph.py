"""The native engine on any graph: other rates and layouts, moved streams, volumes, fallback.

These tests run on PipeWire 0.3, 1.4 and 1.6 alike.
"""

from contextlib import ExitStack, contextmanager, suppress

import numpy as np
import pytest

from audioflinger_hook.service.state import DaemonState
from tests.servers.daemons import (
    FELT,
    felt_hz,
    felt_now,
    links_of,
    longest_silence,
    pitch_hz,
    running,
    stream_named,
    tone,
)
from tests.servers.listening import RATE_HZ, level_db, more, playing, recording, wait_for
from tools.churn import churned
from tools.live_latency.refusing import refusing_pw_cli
from tools.sound_server import MONO, SURROUND_5_1, SoundServer

pytestmark = [pytest.mark.servers]

BACK_S = 1.0  # within this the vibration is back after a change
LEVEL_DB = 0.5  # two equal levels differ by less
HEARD_HZ, OTHER_HZ = 110.0, 900.0  # two tones that vibrate at frequencies of their own


@contextmanager
def native(server, folder, *arguments, **options):
    with (
        running(server, *arguments, engine="native", ready=False, **options) as daemon,
        recording(server, "haptic.monitor", folder / "felt", stays=True) as felt,
    ):
        yield daemon, felt


def felt_back(felt, what, hz=HEARD_HZ):
    """Wait for vibration of a tone; it must come within a second."""

    def is_back() -> bool:
        return felt_now(felt) and abs(pitch_hz(felt()[-RATE_HZ // 4 :]) - felt_hz(hz)) < 4.0

    # a quarter of a second of the tone must have come before its frequency is known
    wait_for(is_back, f"vibration after {what}", BACK_S + 0.25)


def links_from(server: SoundServer, player: str) -> set[str]:
    found, source = set(), ""
    for line in links_of(server).splitlines():
        node, _, port = line.partition("|-> ")[2].partition(":")
        if not line.startswith(" "):
            source = line
        elif source.startswith(f"{player}:") and port.startswith("playback"):
            found.add(node)
    return found


def move(server: SoundServer, stream: str, sink: str) -> None:
    """Move the stream `mover`; WirePlumber 0.4 leaves out a wish now and then."""
    other = next(name for name in server.names("sinks") if name != sink)

    def is_there() -> bool:
        server.pactl("move-sink-input", stream, sink)
        with suppress(AssertionError):
            return wait_for(lambda: links_from(server, "mover") == {sink}, "the move", 1.0)
        server.pactl("move-sink-input", stream, other)
        return False

    wait_for(is_there, f"the stream at {sink}")


def test_a_default_sink_of_44_1_khz_is_felt_at_its_rate(pipewire, tmp_path):
    pipewire.add_sink("slow", rate_hz=44_100)
    pipewire.choose_default("slow")
    with (
        playing(pipewire, "slow", tone(HEARD_HZ, 60.0)),
        native(pipewire, tmp_path) as (daemon, felt),
    ):
        wait_for(lambda: felt_now(felt), "vibration", 20.0)
        more(felt, 0.5)
        # heard at 48 kHz it would be 3.5 Hz off; a cycle that is lost blurs the second by 1 Hz
        assert pitch_hz(more(felt, 1.0)) == pytest.approx(felt_hz(HEARD_HZ), abs=2.0)
        assert daemon.wait(lambda status: status.graph, "figures").state.value == "running"


def test_the_rate_of_the_graph_may_change_while_it_plays(pipewire, tmp_path):
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
            part = more(felt, 2.5)
            assert longest_silence(part * (np.abs(part) > FELT)) < BACK_S * RATE_HZ
            assert pitch_hz(more(felt, 0.5)) == pytest.approx(felt_hz(HEARD_HZ), abs=2.0)
            levels_db.append(level_db(more(felt, 0.5)))
            status = daemon.wait(lambda status: status.graph, "the graph's rate")
            if rate_hz:  # 0.3 leaves it as it is until the graph rests
                assert status.graph.samplerate == rate_hz
            assert status.graph.tap == "streams"
        assert max(levels_db) - min(levels_db) < 1.0


def test_of_two_programs_of_one_name_only_the_one_at_the_sink_is_felt(pipewire, tmp_path):
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


def test_a_stream_that_moves_away_is_not_felt_until_it_is_back(pipewire, tmp_path):
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


def test_refused_links_lead_to_the_monitor_within_a_second_and_status_says_so(pipewire, tmp_path):
    with native(pipewire, tmp_path, variables=refusing_pw_cli(tmp_path)) as (daemon, felt):
        daemon.wait_ready()
        with playing(pipewire, "desktop", tone(HEARD_HZ, 60.0)):
            # the player itself needs up to half a second
            wait_for(lambda: felt_now(felt), "vibration", 1.5)
            status = daemon.wait(
                lambda status: status.graph and status.graph.tap == "monitor", "the monitor"
            )
            assert "desktop:monitor_FL" in links_of(pipewire)
    assert "does not make the links" in status.graph.tap_reason
    assert any("one cycle later" in warning for warning in status.warnings)


def test_volumes_and_mutes_count_alike_on_both_taps(pipewire, tmp_path):
    found: list[list[float]] = []
    for variables in (dict[str, str](), refusing_pw_cli(tmp_path)):
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
                    for asked in (on, off):
                        pipewire.pactl(f"set-{what}-{ask}", one, asked)
                        more(felt, 0.5)
                        levels_db.append(level_db(more(felt, 0.3)))
        found.append(levels_db)
    print("sink 50 %, 100 %, muted, not; stream 50 %, 100 %, muted, not:", *found, sep="\n")
    for streams_db, monitor_db in zip(*found, strict=True):
        assert streams_db == pytest.approx(monitor_db, abs=LEVEL_DB)
    half, full, muted, _, own_half, _, own_muted, _ = found[0]
    assert full - half == pytest.approx(18.06, abs=LEVEL_DB)  # 50 % by the cubic law
    assert full - own_half == pytest.approx(18.06, abs=LEVEL_DB)
    assert max(muted, own_muted) < -100.0


@pytest.mark.parametrize("layout", [MONO, SURROUND_5_1], ids=["mono", "5.1"])
def test_a_sink_of_any_layout_is_felt_as_its_monitor_would_be(pipewire, layout, tmp_path):
    pipewire.add_sink("other", channel_map=layout)
    pipewire.choose_default("other")
    levels_db = []
    for variables in (dict[str, str](), refusing_pw_cli(tmp_path)):
        with (
            playing(pipewire, "other", tone(HEARD_HZ, 60.0)),
            native(pipewire, tmp_path, "--profile", "paper", variables=variables) as (_, felt),
        ):
            wait_for(lambda felt=felt: felt_now(felt), "vibration", 20.0)  # type: ignore[misc]
            more(felt, 1.0)
            levels_db.append(level_db(more(felt, 0.5)))
    assert levels_db[0] == pytest.approx(levels_db[1], abs=LEVEL_DB)


def test_wireplumber_may_be_restarted_while_the_engine_runs(pipewire, tmp_path):
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


@pytest.mark.soak
def test_hundreds_of_nodes_and_streams_that_come_and_go_disturb_nothing(pipewire):
    found = churned(pipewire, 60.0)
    print(found)
    assert found.links_growth == 0
    assert found.memory_growth_kb < 1_024  # ten thousand objects that stay would be more
    assert found.cpu_percent < 5.0
    assert found.heard_gaps_ms <= 40.0  # two cycles: the players alone fill both cores
    assert found.felt_gaps_ms <= 0.01 * 60_000

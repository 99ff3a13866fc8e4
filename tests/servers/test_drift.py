"""Delays that stay what they are: between two sound cards whose clocks differ, and live latency.

The second card is a PulseAudio of its own whose clock runs fast or slow. Null sinks have a pace of
their own besides (their blocks are rounded to microseconds), so the true drift is read off the
two monitors.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.cli.process import freeze_loaded_objects
from audioflinger_hook.config.profiles import LIVE_DEFAULT, parameters_of
from audioflinger_hook.config.settings import LiveSettings
from audioflinger_hook.daemon.capture_queue import CaptureQueue
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.transform import HapticTransform
from device.clock.delay_control import DelayState, DelayStatus
from device.stream import CaptureStream, PcmConfig, PlaybackStream
from device.stream.pcms import ServerDevice
from tests.servers.bare_streams import bare_streams
from tests.servers.daemons import ROOT, environment, running
from tests.servers.listening import ATTEMPTS, RATE_HZ, need, own_server, playing, wait_for
from tools.bench.sections.kept_records import CPU_PERCENT, LAG, NO_GROWTH_MS, USUAL_BLOCK_FRAMES
from tools.latency import main
from tools.live_latency.lag import swelling_tone
from tools.live_latency.pauses import Pause, PauseWitness, undisturbed
from tools.live_latency.record import RECORD, TRUSTED_MS, LiveRecord, keep_records, read_records
from tools.live_latency.recording import Recording
from tools.sound_server import PROGRAMS, SoundServer, missing_clock, missing_programs

pytestmark = pytest.mark.calm

SOAK_S = float(os.environ.get("CUSHION_DRIFT_SOAK_S", "300"))
SHORT_S = 20.0
SETTLES_S = 60.0  # the delay line steers with 0.02 Hz once it has found its target
POLL_S = 0.1
RECOVERS_S = 4.0  # frames are lost, and the clock waits for 2 s before it takes its word
LEAST_CLEAR = 0.7  # of the time, what must be free of such pauses for a run to tell anything


@dataclass(frozen=True)
class Watched:
    """What a delay line told ten times a second once it had settled, and the true drift.

    times_s: when it told each. drift_ppm: how much faster than the second card takes them frames
    come from the first. pauses: when a core, or the whole machine, stood still, or when streams
    that do nothing, beside these ones, got no callbacks in time; what came of them is left out.
    """

    times_s: list[float]
    statuses: list[DelayStatus]
    drift_ppm: float
    pauses: tuple[Pause, ...]

    @property
    def clear(self) -> np.ndarray:
        return undisturbed(np.array(self.times_s), self.pauses, RECOVERS_S)

    @property
    def errors_ms(self) -> np.ndarray:
        errors_s = np.array([status.delay_s - status.target_s for status in self.statuses])
        return np.asarray(1e3 * errors_s[self.clear])

    @property
    def ratio_ppm(self) -> float:
        return float(np.mean(np.array([each.ratio_ppm for each in self.statuses])[self.clear]))

    @property
    def resyncs(self) -> int:
        return int(np.sum(np.diff([status.resyncs for status in self.statuses])[self.clear[1:]]))

    def __str__(self) -> str:
        errors_ms = self.errors_ms
        longest_ms = max((1e3 * pause.seconds for pause in self.pauses), default=0.0)
        return (
            f"drift {self.drift_ppm:+.0f} ppm, mean ratio {self.ratio_ppm:+.0f} ppm, delay less "
            f"target {errors_ms.min():+.2f} to {errors_ms.max():+.2f} ms, target "
            f"{1e3 * self.statuses[-1].target_s:.2f} ms, {self.resyncs} resyncs; "
            f"{len(self.pauses)} times a core or bare streams stood "
            f"still, up to {longest_ms:.0f} ms: {100.0 * np.mean(self.clear):.0f} % of the time "
            "counts"
        )


@contextmanager
def two_cards(ratio: float, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[SoundServer]]:
    """A server of the usual pace and one whose clock runs at this ratio to it."""
    need(missing_programs("pulse") + missing_clock())
    with ExitStack() as stack:
        clocks = (own_server("pulse", clock_ratio=clock_ratio) for clock_ratio in (1.0, ratio))
        servers = [stack.enter_context(one) for one in clocks]
        for name, value in servers[0].environment.items():
            if name.startswith(("PULSE_", "XDG_", "HOME", "DBUS_")):
                monkeypatch.setenv(name, value)
        yield servers


@contextmanager
def bridged(heard: SoundServer, felt: SoundServer) -> Iterator[Engine]:
    """The engine between the first card's `desktop` and the second one's `haptic`."""
    config = PcmConfig("cushion_tap", "cushion_output")
    clocks, feed = Clocks(time.monotonic, time.thread_time), CaptureQueue()
    client, blocks = feed.client(RATE_HZ, 2), LiveSettings.block_frames
    engine = Engine(client, RATE_HZ, clocks=clocks, now_s=time.monotonic(), block_frames=blocks)
    feed.serve(engine)
    feed.opened(RATE_HZ, 2)

    streams: list[CaptureStream | PlaybackStream] = []
    try:
        config.pcms["cushion_output"].target = ServerDevice("haptic", felt.address)
        playback = PlaybackStream(
            config.pcms["cushion_output"], RATE_HZ, 2, engine.fill, block_frames=blocks
        )
        streams.append(playback)
        playback.audible = True
        config.pcms["cushion_tap"].target = ServerDevice("desktop.monitor", heard.address)
        streams.append(
            CaptureStream(config.pcms["cushion_tap"], RATE_HZ, 2, feed.push, block_frames=blocks)
        )
        freeze_loaded_objects()  # as the daemon does
        yield engine
        assert all(stream.errors == {} for stream in streams)
    finally:
        for stream in streams:
            stream.close()
        config.close()


def watched(ratio, seconds, settles_s, monkeypatch):
    """What the delay line does for `seconds` once it has played for settles_s."""
    tone = swelling_tone(145.0, 60.0, RATE_HZ)[:, None].repeat(2, axis=1).astype(np.float32)
    length = int((settles_s + seconds + 30.0) / 60.0) + 1
    with (
        closing(PauseWitness()) as witness,
        two_cards(ratio, monkeypatch) as (first, second),
        playing(first, "desktop", np.tile(tone, (length, 1))),
        bridged(first, second) as engine,
        bare_streams(
            os.environ, "desktop.monitor", "haptic", first.address, second.address
        ) as bare,
        closing(recording(first, "desktop")) as captured,
        closing(recording(second, "haptic")) as taken,
    ):
        line = engine.delay_line
        wait_for(lambda: line.status.state is DelayState.SETTLING, "vibration", 20.0)
        began_s = time.monotonic()
        times_s: list[float] = []
        statuses: list[DelayStatus] = []

        def over():
            now_s = time.monotonic()
            elapsed_s = now_s - began_s
            captured.drain()
            taken.drain()
            if elapsed_s > settles_s + POLL_S * len(statuses):
                times_s.append(now_s)
                statuses.append(line.status)
            return elapsed_s > settles_s + seconds

        wait_for(over, "the end", settles_s + seconds + 10.0)
        drift_ppm = taken.line().drift_ppm - captured.line().drift_ppm
        every_pause = (*witness.core_pauses(), *bare.gaps)
        pauses = tuple(pause for pause in every_pause if pause.end_s > began_s)
    result = Watched(times_s, statuses, drift_ppm, pauses)
    if not result.clear.any():
        pytest.skip("frames are lost all the time, whoever asks for them")
    print(f"clock x{ratio:g}, {seconds:.0f} s: {result}")
    if np.mean(result.clear) < LEAST_CLEAR:
        pytest.skip(f"frames are lost too often, whoever asks for them: {result}")
    return result


def recording(server: SoundServer, sink: str) -> Recording:
    return Recording(f"{sink}.monitor", RATE_HZ, server.environment, lambda _: None)


@pytest.mark.servers
def test_a_card_that_is_fast_is_followed(monkeypatch):
    found = watched(1.0002, SHORT_S, SHORT_S, monkeypatch)
    assert found.resyncs == 0
    # Twice what is allowed when all has settled, which takes a minute.
    assert np.abs(found.errors_ms).max() <= 2.0


@pytest.mark.soak
@pytest.mark.parametrize("ratio", [0.9998, 1.0, 1.0002])
def test_the_delay_stays_on_its_target_for_minutes(ratio, monkeypatch):
    settles_s = min(SETTLES_S, SOAK_S / 2.0)
    found = watched(ratio, SOAK_S - settles_s, settles_s, monkeypatch)
    assert found.resyncs == 0
    assert np.abs(found.errors_ms).max() <= 1.0
    assert found.ratio_ppm == pytest.approx(found.drift_ppm, abs=30.0)


WATCHED_S = float(os.environ.get("CUSHION_LATENCY_SOAK_S", "600"))


def latency(*arguments: str, environ: dict[str, str] | None = None) -> Any:
    command = [sys.executable, str(ROOT / "tools/latency.py"), *arguments]
    pipes: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    return subprocess.run(command, env=environ, timeout=120.0, **pipes)


def measured(arguments: list[str], environ: dict[str, str] | None = None) -> Any:
    for attempt in range(1, ATTEMPTS + 1):
        done = latency("--json", *arguments, environ=environ)
        assert done.stderr == ""
        document = json.loads(done.stdout)
        assert document["schema"] == 1
        (found,) = document["records"]
        assert set(found) == {field.name for field in fields(LiveRecord)}
        record = LiveRecord(**found)
        print(record)
        usable = record.trusted and record.lag_median_ms is not None
        assert done.returncode == (0 if usable else 1)
        if usable or attempt == ATTEMPTS:
            return record
    raise AssertionError("unreachable")


@pytest.mark.servers
@pytest.mark.parametrize("kind", ["pipewire", pytest.param("pulse", marks=pytest.mark.soak)])
def test_the_tool_finds_a_plausible_lag_and_no_error_of_its_own(kind, tmp_path):
    need(missing_programs(kind))
    kept = tmp_path / "live.json"
    record = measured(["--kind", kind, "--seconds", "12", "--out", str(kept)])
    assert kind in record.server.lower()
    assert record.trusted
    assert abs(record.check_median_ms or 0.0) <= TRUSTED_MS
    assert 20.0 < record.lag_median_ms < 150.0
    # the budget leaves out what servers hold back, and no more than that
    assert -5.0 < record.lag_median_ms - record.budget_ms < 60.0
    transform = HapticTransform(RATE_HZ, 2, parameters_of(LIVE_DEFAULT))
    assert record.transform_ms == pytest.approx(1e3 * transform.latency_s, abs=0.1)
    assert (len(record.lags_ms), [each.name for each in read_records(kept)]) == (4, [record.name])


@pytest.mark.servers
def test_a_daemon_that_already_runs_is_measured_where_it_is(pipewire):
    done = latency("--here", environ=environment(pipewire))
    assert done.returncode == 1
    assert done.stderr == "latency: error: no daemon plays here; start one with `cushion run`\n"
    with running(pipewire):
        record = measured(["--here", "--play", "--seconds", "6"], environment(pipewire))
    assert record.block_frames is None
    assert 20.0 < record.lag_median_ms < 150.0
    assert abs(record.check_median_ms or 0.0) <= TRUSTED_MS


@pytest.mark.soak
@pytest.mark.parametrize("kind", sorted(PROGRAMS))
def test_the_latency_is_short_and_does_not_grow(kind, monkeypatch):
    need(missing_programs(kind))
    with tempfile.TemporaryDirectory(prefix="cushion-") as folder:
        out = Path(folder) / "live.json"
        arguments = ["--kind", kind, "--seconds", str(WATCHED_S), "--out", str(out)]
        monkeypatch.setattr(sys, "argv", ["latency.py", *arguments])
        code = main()
        record: Any = read_records(out)[0]
    keep_records([record], ROOT / RECORD)  # a failure is kept as well
    assert code == 0
    assert record.block_frames == USUAL_BLOCK_FRAMES
    if record.busy:
        pytest.skip(f"load over {record.cores}, where nothing is promised: {record}")
    assert LAG.met(record.lag_median_ms), record
    assert NO_GROWTH_MS.met(abs(record.hidden_growth_ms)), record
    assert NO_GROWTH_MS.met(abs(record.growth_ms)), record
    assert CPU_PERCENT.met(record.cpu_percent), record

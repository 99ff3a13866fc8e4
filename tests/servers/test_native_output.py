"""The native engine on PipeWire: the bytes of ctypes, how late bursts are felt, and its memory."""

import ctypes
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.core import blob
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.structures import Controls
from audioflinger_hook.daemon.native.layout import Layout
from device.units import Float32Array
from tests.servers.daemons import Daemon, configured, cushion, felt_now, running
from tests.servers.listening import RATE_HZ, noise, playing, recording, wait_for, wait_seconds
from tests.servers.witness import Verdict, tears, witness_tone
from tests.support.data import text
from tools.beginnings import lost_cycles
from tools.burst_latency import measured_here
from tools.live_latency.bursts import burst_delays
from tools.live_latency.refusing import refusing_pw_cli
from tools.live_latency.usage import held_by_family
from tools.usage import CARE

pytestmark = [pytest.mark.servers, pytest.mark.calm]

LIMITED = text("two-limited.toml")
"""Two actuators: one that protection limits in every burst, one that only waits for it."""

COMPARED_S = 2.5
BEGUN_FRAMES = 48_000


def loud(rate_hz: int) -> Float32Array:
    """Two seconds of noise between silence; links may come within two seconds of a stream."""
    sound = 2.0 * noise(5.0 * rate_hz / RATE_HZ) - 0.5
    sound[: 2 * rate_hz] = sound[-rate_hz:] = 0.0
    return sound


def played_by_ctypes(design, controls, lead, sound):
    """What a core makes of a sound after so many frames of silence, from the first that sounds."""
    core = Core(design)
    ctypes.memmove(core._controls, controls, len(controls))
    core.process(np.zeros((lead, 2), np.float32))
    return sounding(core.process(sound))


def sounding(frames: Float32Array) -> Float32Array:
    return frames[np.argmax(frames.any(axis=1)) :]


def is_played(design: bytes, page: bytes, sound: Float32Array, got: Float32Array) -> bool:
    """Whether a recording is what ctypes gives, from the first frame that sounds.

    How long the node ran before is not known, but that it was longer than the fade of a beginning.
    It counts for protection, whose blocks and holding times go on in silence: all leads within a
    block, and then within a holding time, are tried by beginnings that grow longer.
    """
    controls = page[Layout.banks.offset :][: ctypes.sizeof(Controls)]
    records = blob.unpack(design)
    block, holds = (records.get(f"0/protection.{name}", 1) for name in ("frames", "hold_blocks"))
    assert isinstance(block, int)
    assert isinstance(holds, int)

    def fitting(leads: Iterable[int], frames: int) -> list[int]:
        enough = sound[: frames + len(sound) // 16]
        whole = np.zeros((1, 2))  # no negative zeros
        return [
            lead
            for lead in leads
            if np.array_equal(
                played_by_ctypes(design, controls, lead, enough)[:frames] + whole, got[:frames]
            )
        ]

    begun = BEGUN_FRAMES - BEGUN_FRAMES % (block * holds)
    leads = fitting(fitting(range(begun, begun + block), 16 * block), 64 * block)
    held = [lead + hold * block for lead in leads for hold in range(holds)]
    return bool(fitting(fitting(held, 256 * block), len(got)))


@pytest.mark.parametrize(
    ("config", "quantum", "rate_hz"),
    [
        ("", 256, 48_000),
        *((LIMITED, *graph) for graph in ((64, 48_000), (1_024, 48_000), (1_024, 44_100))),
        *(
            pytest.param(LIMITED, *graph, marks=pytest.mark.soak)
            for graph in ((256, 48_000), (4_096, 48_000), (8_192, 48_000), (1_024, 96_000))
        ),
    ],
)
def test_the_node_gives_the_bytes_of_ctypes(pipewire, tmp_path, config, quantum, rate_hz):
    for name in ("played", "felt"):
        pipewire.add_sink(name, rate_hz=rate_hz)
    pipewire.choose_default("played")
    pipewire.set_clock("force-rate", rate_hz)
    pipewire.set_clock("force-quantum", quantum)
    _, named = configured(tmp_path, config)
    sound, frames = loud(rate_hz), round(COMPARED_S * rate_hz)

    # at this quantum a new stream's links may miss its first cycles
    after_silence = np.concatenate([np.zeros((rate_hz, sound.shape[1]), sound.dtype), sound])

    def attempt() -> bool:
        with (
            running(pipewire, *named, device="felt", engine="native") as daemon,
            recording(pipewire, "felt.monitor", tmp_path / "heard", rate_hz=rate_hz) as felt,
            playing(pipewire, "played", after_silence, rate_hz=rate_hz),
        ):
            wait_for(lambda: felt().any(), "vibration", 20.0)
            wait_for(lambda: len(sounding(felt())) > frames, "the end", 20.0)
            graph: Any = daemon.wait(lambda status: status.graph, "the graph").graph
            design, page = (
                next((pipewire.folder / "cushion").glob(f"haptic-cushion-*.{end}")).read_bytes()
                for end in ("design", "page")
            )
            got = sounding(felt())[:frames]
        assert (graph.cycle_frames, graph.samplerate) == (quantum, rate_hz)
        return is_played(design, page, sounding(sound), got)

    # other bytes would differ each time; a lost cycle may change them twice
    verdict, shown = Verdict(f"{quantum} frames at {rate_hz} Hz", needed=1, stray=2), False
    with witness_tone(tmp_path, quantum) as witness:
        while not shown:
            begun, good = len(witness()), attempt()
            shown = verdict.add("other bytes", good=good, witness_torn=tears(witness()[begun:]) > 0)


QUANTUM, BURSTS = 1_024, 9
WINDOW_FRAMES = RATE_HZ // 20


def with_care(folder: Path, rig: str = "paper") -> tuple[str, str]:
    return configured(folder, f'{CARE}rig = "{rig}"\n')[1]


def test_with_all_care_for_the_rig_bursts_are_felt_4_ms_later(timed_pipewire, tmp_path):
    with running(timed_pipewire, *with_care(tmp_path), engine=None) as daemon:
        status = daemon.wait_ready()
        found = measured_here(timed_pipewire, QUANTUM, RATE_HZ, BURSTS, tmp_path)
        seen: Any = daemon.wait(lambda s: s.protection and s.protection.blocks, "protection")
    print(found.told)
    assert (status.engine, status.engine_reason) == ("native", "")
    assert found.half_median_ms <= 14.0
    assert found.half_p95_ms <= 18.0
    # a burst over silence passes half of its peak early: its gate opens with its first samples
    assert -4.0 < found.half_median_ms - found.budget_ms < 3.0
    assert (seen.latency.driving_ms, seen.exposure.cap) == (pytest.approx(4.0), "action")


def levels_db(vibration: Float32Array) -> Float32Array:
    whole = vibration[: len(vibration) // WINDOW_FRAMES * WINDOW_FRAMES]
    power = np.mean(whole.reshape(-1, WINDOW_FRAMES).astype(np.float64) ** 2, axis=1)
    return np.asarray(10.0 * np.log10(np.maximum(power, 1e-12)), np.float32)


def bursts() -> Float32Array:
    """Bursts of tones that protection has to limit, between silence and soft tones."""
    at_s = np.arange(6 * RATE_HZ) / RATE_HZ
    loud = np.sin(2.0 * np.pi * 440.0 * at_s) * ((at_s % 1.0) < 0.4)
    soft = 0.05 * np.sin(2.0 * np.pi * 1_100.0 * at_s)
    sound = np.repeat((0.9 * loud + soft)[:, None], 2, axis=1).astype(np.float32)
    sound[: RATE_HZ // 2] = sound[-RATE_HZ:] = 0.0
    return sound


def felt_bursts(server, care, folder) -> tuple[Float32Array, bool]:
    """The vibration of `bursts`, and whether another server lost a cycle meanwhile."""
    with (
        witness_tone(folder) as witness,
        running(server, *care, engine="native"),
        recording(server, "haptic.monitor", folder / "felt") as felt,
        playing(server, "desktop", bursts()),
    ):
        begin = len(witness())
        wait_for(lambda: felt_now(felt), "vibration")
        frames = len(felt()) + 6 * RATE_HZ
        wait_for(lambda: len(felt()) > frames, "the end", 20.0)
        return felt()[:, 0], tears(witness()[begin:]) > 0


@pytest.mark.parametrize("rig", ["paper", "consumer"])
def test_the_level_is_that_of_render_with_the_same_config(timed_pipewire, tmp_path, rig):
    care = with_care(tmp_path, rig)
    files = str(tmp_path / "sound.wav"), str(tmp_path / "vibration.wav")
    soundfile.write(files[0], bursts(), RATE_HZ, subtype="FLOAT")
    done = cushion(timed_pipewire, "render", *files, "--profile", LIVE_DEFAULT, *care)
    assert done.code == 0
    wanted, _ = soundfile.read(files[1], dtype="float32", always_2d=True)
    # Damping begins with the first sample that is not 0, in both.
    reference = wanted[np.flatnonzero(wanted[:, 0])[0] :, 0]
    expected = levels_db(reference[: 4 * RATE_HZ])
    audible = expected > expected.max() - 40.0
    assert np.count_nonzero(audible) > 30
    verdict, shown = Verdict("the level of render", needed=1), False
    while not shown:
        got, witness_torn = felt_bursts(timed_pipewire, care, tmp_path)
        got = got[np.flatnonzero(got)[0] :]
        worst_db = float(np.abs(levels_db(got[: 4 * RATE_HZ]) - expected)[audible].max())
        shown = verdict.add(worst_db, good=worst_db < 1.0, witness_torn=witness_torn)


def test_a_direct_link_has_no_delay(timed_pipewire, tmp_path):
    found = burst_delays(BURSTS, RATE_HZ, tmp_path, timed_pipewire.environment, direct=True)
    assert found.half_ms.size == BURSTS
    assert np.abs(found.half_ms).max() < 1.0


def test_bursts_are_felt_soon_by_streams_and_a_cycle_later_by_the_monitor(timed_pipewire, tmp_path):
    found = {}
    for tap, variables in (("streams", {}), ("monitor", refusing_pw_cli(tmp_path))):
        # of some 150 runs, one was another cycle late to its end; the cause is not known
        verdict, shown = Verdict(f"the delay of {tap}", needed=1), False
        while not shown:
            with running(timed_pipewire, engine="native", variables=variables):
                found[tap] = measured_here(timed_pipewire, QUANTUM, RATE_HZ, BURSTS, tmp_path)
            print(found[tap].told)
            assert found[tap].tap == tap
            as_told = abs(found[tap].half_median_ms - found[tap].budget_ms) < 3.0
            shown = verdict.add(found[tap].told, good=as_told, witness_torn=False)
    streams, monitor = found["streams"], found["monitor"]
    assert streams.half_median_ms <= 10.0
    assert streams.half_p95_ms <= 14.0
    assert streams.tenth_median_ms <= 6.0
    cycle_ms = 1e3 * QUANTUM / RATE_HZ
    assert monitor.half_median_ms - streams.half_median_ms == pytest.approx(cycle_ms, abs=1.0)


@pytest.mark.parametrize("player", ["pw-play", pytest.param("paplay", marks=pytest.mark.soak)])
def test_the_beginning_of_a_new_stream_is_felt(timed_pipewire, player, tmp_path):
    with running(timed_pipewire, engine="native"):
        lost = lost_cycles(player, 8, tmp_path, timed_pipewire.environment)
    assert max(lost) <= 1
    assert sum(lost) <= 4  # of a busy machine; where links come too late, each stream loses one


MOST_MB, BESIDE_MB = 70.0, 8.0
PLAYED_S = 5.0  # it does not grow after that: tools/usage.py prints the same after ten minutes


def change(daemon: Daemon, config: Path, lines: str) -> None:
    """Let it read other settings, and wait until they play."""
    before = daemon.wait_ready().engine_pid
    daemon.reload(config, CARE + lines)
    wait_seconds(1.0)  # the change takes 0.3 s
    assert daemon.wait_ready().engine_pid == before


def check_memory(daemon: Daemon) -> None:
    """Daemon and native engine hold at most MOST_MB, and the programs beside them little."""
    time.sleep(PLAYED_S)
    held = dict(held_by_family(daemon.process.pid).values())
    print(held)
    own = held.pop("python") + held.pop("pipewire")
    assert own <= MOST_MB
    assert sum(held.values()) <= BESIDE_MB  # pw-cli, pw-dump and, now and then, pw-top


def test_daemon_and_native_engine_hold_70_mb_at_most(pipewire, tmp_path):
    config, named = configured(tmp_path, CARE)
    with (
        playing(pipewire, "desktop", noise(60.0)),
        running(pipewire, *named, engine="native") as daemon,
    ):
        check_memory(daemon)
        for lines in ('profile = "game"\n', 'rig = "consumer"\n', 'profile = "music"\n'):
            change(daemon, config, lines)
            check_memory(daemon)

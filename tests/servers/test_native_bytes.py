"""The node in PipeWire's graph gives the bytes that ctypes gives, with any cycle and rate."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.core import blob
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.structures import Controls
from audioflinger_hook.daemon.native.layout import Layout
from device.units import Float32Array
from tests.servers.conftest import started
from tests.servers.daemons import running
from tests.servers.listening import RATE_HZ, noise, playing, recording, wait_for
from tests.servers.witness import Verdict, tears, witness_tone
from tools.sound_server import SoundServer

pytestmark = [pytest.mark.servers, pytest.mark.calm]

CARE = """protection = "on"
[[actuator]]
channels = [0]
source = "left"
rig = "consumer"
damping = "auto"
exposure_cap = "action"
[[actuator]]
channels = [1]
source = "mix"
gain_db = -6.0
polarity = "inverted"
"""
"""Two actuators: one that protection limits in every burst, one that only waits for it."""

COMPARED_S = 2.5
BEGUN_FRAMES = 48_000


@pytest.fixture
def pipewire(monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    yield from started("pipewire", monkeypatch)


def loud(rate_hz: int) -> Float32Array:
    """Two seconds of noise between silence; links may come within two seconds of a stream."""
    sound = 2.0 * noise(5.0 * rate_hz / RATE_HZ) - 0.5
    sound[: 2 * rate_hz] = sound[-rate_hz:] = 0.0
    return sound


def played_by_ctypes(
    design: bytes, controls: bytes, lead: int, sound: Float32Array
) -> Float32Array:
    """What a core makes of a sound after so many frames of silence, from the first that sounds."""
    core = Core(design)
    ctypes.memmove(core._controls, controls, len(controls))
    core.process(np.zeros((lead, 2), np.float32))
    return sounding(core.process(sound))


def sounding(frames: Float32Array) -> Float32Array:
    """Frames from the first that is not silent."""
    return frames[np.argmax(frames.any(axis=1)) :]


def is_played(design: bytes, page: bytes, sound: Float32Array, got: Float32Array) -> bool:
    """Whether a recording is what ctypes gives, from the first frame that sounds.

    How long the node ran before is not known, but that it was longer than the fade of a beginning.
    It counts for protection, whose blocks and holding times go on in silence: all leads within a
    holding time are tried, by short beginnings at first.
    """
    controls = page[Layout.controls.offset :][: ctypes.sizeof(Controls)]
    records = blob.unpack(design)
    block, holds = (records.get(f"0/protection.{name}", 1) for name in ("frames", "hold_blocks"))
    assert isinstance(block, int)
    assert isinstance(holds, int)

    def fits(lead: int, frames: int) -> bool:
        wanted = played_by_ctypes(design, controls, lead, sound[: frames + len(sound) // 4])[
            :frames
        ]
        return len(wanted) == frames and np.array_equal(wanted + np.zeros((1, 2)), got[:frames])

    begun = BEGUN_FRAMES - BEGUN_FRAMES % (block * holds)
    leads = [begun + lead for lead in range(block) if fits(begun + lead, 16 * block)]
    held = [lead + hold * block for lead in leads for hold in range(holds)]
    return any(fits(lead, len(got)) for lead in held)


GRAPHS = [(64, 48_000), (256, 48_000), (1_024, 48_000), (4_096, 48_000), (8_192, 48_000),
          (1_024, 44_100), (1_024, 96_000)]  # fmt: skip


@pytest.mark.parametrize(
    ("config", "quantum", "rate_hz"),
    [*((CARE, *graph) for graph in GRAPHS), ("", *GRAPHS[1])],
)
def test_the_node_gives_the_bytes_of_ctypes(
    pipewire: SoundServer, tmp_path: Path, config: str, quantum: int, rate_hz: int
) -> None:
    for name in ("played", "felt"):
        pipewire.add_sink(name, rate_hz=rate_hz)
    pipewire.choose_default("played")
    pipewire.set_clock("force-rate", rate_hz)
    pipewire.set_clock("force-quantum", quantum)
    path = tmp_path / "config.toml"
    path.write_text(config)
    sound, frames = loud(rate_hz), round(COMPARED_S * rate_hz)

    # at this quantum a new stream's links may miss its first cycles
    after_silence = np.concatenate([np.zeros((rate_hz, sound.shape[1]), sound.dtype), sound])

    def attempt() -> bool:
        with (
            running(pipewire, "--config", str(path), device="felt", engine="native") as daemon,
            recording(pipewire, "felt.monitor", tmp_path / "heard", rate_hz=rate_hz) as felt,
            playing(pipewire, "played", after_silence, rate_hz=rate_hz),
        ):
            wait_for(lambda: felt().any(), "vibration", 20.0)
            wait_for(lambda: len(sounding(felt())) > frames, "the end", 20.0)
            graph = daemon.wait(lambda status: status.graph, "the graph").graph
            design, page = (
                next((pipewire.folder / "cushion").glob(f"haptic-cushion-*.{end}")).read_bytes()
                for end in ("design", "page")
            )
            got = sounding(felt())[:frames]
        assert graph
        assert (graph.cycle_frames, graph.samplerate) == (quantum, rate_hz)
        return is_played(design, page, sounding(sound), got)

    verdict, shown = Verdict(f"{quantum} frames at {rate_hz} Hz", needed=1, stray=0), False
    with witness_tone(tmp_path, quantum) as witness:
        while not shown:
            begun = len(witness())
            good = attempt()
            shown = verdict.add("other bytes", good=good, witness_torn=tears(witness()[begun:]) > 0)

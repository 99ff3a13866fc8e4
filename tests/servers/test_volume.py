"""The listener's volume changes nothing that is felt where vibration follows loudness."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from device.units import Float32Array
from tests.servers.daemons import running, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tools.sound_server import SoundServer

CHANGE_DB = 1.0
"""20 dB that are not undone give 12.6 dB."""

STEP_CHANGE_DB = 2.0
"""Of the level after a step, against that before."""

TAP_DB = 8.0
"""Sound and the news of its volume come some ms apart, and a step of a tone is a click. So a step
is felt as a tap of up to 0.1 s: by the 6.5 dB of a rise at most, and its own 1.3 dB."""

SETTLES_S = 4.5
"""Until a louder moment of 20 dB is forgotten."""

AS_THE_PROGRAMME = 0.06
"""A tone of 110 Hz as loud as the programme is at first: felt as strongly from then on."""

WINDOW_S = 0.6
PART_FRAMES = 2_400
"""The median of parts is the level: a gap of a busy machine is none of the volume's."""


def level_db(felt: Callable[[], Float32Array], after_s: float) -> float:
    """The level of what is felt after this time."""
    first = len(felt()) + int(after_s * RATE_HZ)
    wait_for(lambda: len(felt()) > first + WINDOW_S * RATE_HZ, "more of it")
    heard = felt()[first : first + int(WINDOW_S * RATE_HZ)]
    return float(np.median([rms_db(part) for part in parts_of(heard)]))


def parts_of(frames: Float32Array) -> list[Float32Array]:
    return np.array_split(frames, len(frames) // PART_FRAMES)


def rms_db(frames: Float32Array) -> float:
    return float(10.0 * np.log10(np.mean(frames[:, 0].astype(np.float64) ** 2) + 1e-20))


def player_of(server: SoundServer) -> str:
    lines = server.pactl("list", "sink-inputs").split("Sink Input #")
    return next(one.split()[0] for one in lines if 'media.role = "music"' in one)


@pytest.mark.parametrize("engine", ["python", "native"])
def test_a_volume_of_stream_or_sink_is_not_felt(
    server: SoundServer, tmp_path: Path, engine: str
) -> None:
    if engine == "native" and server.kind != "pipewire":
        pytest.skip("the native engine needs PipeWire")
    with (
        running(server, "--profile", "cinema", engine=engine) as daemon,
        playing(server, "desktop", tone(110.0, 90.0, AS_THE_PROGRAMME)),
        recording(server, "haptic.monitor", tmp_path / "felt", stays=True) as felt,
    ):
        before_db = level_db(felt, 3.0)
        assert before_db > -40.0
        player = player_of(server)
        # a factor: pactl 17 sets a stream to 0 for a volume in dB
        server.pactl("set-sink-input-volume", player, "0.1")
        stream_db = level_db(felt, SETTLES_S)
        status = daemon.status()
        server.pactl("set-sink-volume", "desktop", "-12dB")
        both_db = level_db(felt, SETTLES_S)
        both = daemon.status()
        server.pactl("set-sink-volume", "desktop", "100%")
        server.pactl("set-sink-input-volume", player, "100%")
        again_db = level_db(felt, SETTLES_S)
        begun = len(felt())
        for percent in (95, 90, 85, 80, 85, 90, 95, 100):  # as keys of a keyboard make it
            server.pactl("set-sink-volume", "desktop", f"{percent}%")
            level_db(felt, 0.0)
        stepped = felt()[begun:]
    found = [before_db, stream_db, both_db, again_db]
    steps = [rms_db(part) for part in parts_of(stepped)]
    print(f"{server.kind}, {engine}: {np.round(found, 2)} dB, steps {np.ptp(steps):.1f} dB")
    assert status is not None
    assert status.volume_db == pytest.approx(-20.0, abs=0.2)
    assert both is not None
    assert both.volume_db == pytest.approx(-32.0, abs=0.2)
    assert found == pytest.approx([before_db] * 4, abs=CHANGE_DB)
    assert max(steps) - before_db < TAP_DB
    settled = [float(np.median(part)) for part in np.array_split(steps, 8)]
    off = [level for level in settled if abs(level - before_db) > STEP_CHANGE_DB]
    assert not off, off


def test_the_paper_s_profile_feels_the_volume_as_it_is_heard(
    server: SoundServer, tmp_path: Path
) -> None:
    with (
        running(server, "--profile", "paper") as daemon,
        playing(server, "desktop", tone(110.0, 90.0, 0.2)),
        recording(server, "haptic.monitor", tmp_path / "felt", stays=True) as felt,
    ):
        before_db = level_db(felt, 2.0)
        server.pactl("set-sink-input-volume", player_of(server), "0.1")
        assert level_db(felt, 0.4) == pytest.approx(before_db - 20.0, abs=0.5)
        status = daemon.status()
    assert status is not None
    assert status.volume_db == 0.0

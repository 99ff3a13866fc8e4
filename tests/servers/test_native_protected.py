"""The native engine with protection, damping and an exposure cap: what is felt, and how late."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook.config.profiles import LIVE_DEFAULT
from device.units import Float32Array
from tests.servers.conftest import started
from tests.servers.daemons import cushion, felt_now, running, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tools.burst_latency import measured_here
from tools.live_latency.bursts import REFERENCE
from tools.sound_server import SoundServer

pytestmark = [pytest.mark.servers, pytest.mark.calm]

CARE = 'protection = "on"\ndamping = "auto"\nexposure_cap = "action"\n'
QUANTUM, BURSTS = 1_024, 9
WINDOW_FRAMES = RATE_HZ // 20


@pytest.fixture
def pipewire(monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    for server in started("pipewire", monkeypatch):
        server.add_reference(REFERENCE)
        server.set_clock("force-quantum", QUANTUM)
        yield server


def with_care(folder: Path, rig: str = "paper") -> tuple[str, str]:
    """The arguments for a config with all that is done for a rig."""
    path = folder / "care.toml"
    path.write_text(f'{CARE}rig = "{rig}"\n')
    return "--config", str(path)


def test_with_all_care_for_the_rig_bursts_are_felt_four_milliseconds_later(
    pipewire: SoundServer, tmp_path: Path
) -> None:
    with running(pipewire, *with_care(tmp_path), engine=None) as daemon:
        status = daemon.wait_ready()
        found = measured_here(pipewire, QUANTUM, RATE_HZ, BURSTS, tmp_path)
        seen = daemon.wait(lambda s: s.protection and s.protection.blocks, "blocks of protection")
    print(found.told)
    assert (status.engine, status.engine_reason) == ("native", "")
    assert found.half_median_ms <= 14.0
    assert found.half_p95_ms <= 18.0
    # a burst over silence passes half of its peak early: its gate opens with its first samples
    assert -4.0 < found.half_median_ms - found.budget_ms < 3.0
    assert seen.latency.driving_ms == pytest.approx(4.0)
    assert seen.protection
    assert seen.protection.coil_c is not None
    assert seen.exposure
    assert seen.exposure.cap == "action"


def levels_db(vibration: Float32Array) -> Float32Array:
    """The level of each window of 50 ms, in dBFS."""
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


@pytest.mark.parametrize("rig", ["paper", "consumer"])
def test_the_level_is_that_of_render_with_the_same_config(
    pipewire: SoundServer, tmp_path: Path, rig: str
) -> None:
    care = with_care(tmp_path, rig)
    files = str(tmp_path / "sound.wav"), str(tmp_path / "vibration.wav")
    soundfile.write(files[0], bursts(), RATE_HZ, subtype="FLOAT")
    assert cushion(pipewire, "render", *files, "--profile", LIVE_DEFAULT, *care).returncode == 0
    wanted, _ = soundfile.read(files[1], dtype="float32", always_2d=True)
    with (
        running(pipewire, *care, engine="native"),
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        playing(pipewire, "desktop", bursts()),
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        frames = len(felt()) + 6 * RATE_HZ
        wait_for(lambda: len(felt()) > frames, "the end", 20.0)
        got = felt()[:, 0]
    # Damping begins with the first sample that is not 0, in both.
    got, reference = got[np.flatnonzero(got)[0] :], wanted[np.flatnonzero(wanted[:, 0])[0] :, 0]
    frames = 4 * RATE_HZ
    expected = levels_db(reference[:frames])
    audible = expected > expected.max() - 40.0
    assert np.count_nonzero(audible) > 30
    difference_db = np.abs(levels_db(got[:frames]) - expected)[audible]
    print(f"{rig}: largest difference {difference_db.max():.3f} dB")
    assert difference_db.max() < 1.0


def test_a_native_engine_that_is_killed_leaves_its_heat_and_dose_to_the_next(
    pipewire: SoundServer,
) -> None:
    record = Path(pipewire.environment["XDG_STATE_HOME"]) / "cushion" / "actuators.json"
    care = ("--protection", "on")
    with playing(pipewire, "desktop", tone(60.0, 60.0)):
        with running(pipewire, *care, engine="native") as daemon:
            seen = daemon.wait(lambda s: s.exposure and s.exposure.a8_m_s2, "a dose")
            assert not seen.warnings
            wait_for(record.exists, "the record")
            daemon.wait(
                lambda _: json.loads(record.read_text())["actuators"]["haptic 0.0"]["dose"][
                    "squares"
                ],
                "a recorded dose",
            )
            daemon.process.kill()
        known = json.loads(record.read_text())
        known["actuators"]["haptic 0.0"]["coil_c"] = 110.0
        known["actuators"]["haptic 0.0"]["magnet_c"] = 60.0
        record.write_text(json.dumps(known))
        with running(pipewire, *care, engine="native") as daemon:
            seen = daemon.wait(lambda s: s.protection and s.protection.blocks, "protection")
            assert seen.protection
            assert seen.protection.coil_c is not None
            assert 80.0 < seen.protection.coil_c < 120.0
            assert seen.exposure
            squares = known["actuators"]["haptic 0.0"]["dose"]["squares"]
            assert seen.exposure.a8_m_s2 >= (squares / 28_800.0) ** 0.5
            assert not any("coils count" in warning for warning in seen.warnings)

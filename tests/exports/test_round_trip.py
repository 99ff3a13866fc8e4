"""What a player makes of a file is the vibration that it was made from."""

from pathlib import Path

import numpy as np
import pytest
import soundfile

from tests.support.exports import RATE_HZ, exported, read_wave, scene
from tools.exports.renderers import RENDERERS
from tools.exports.round_trip import PLAYED_HZ, round_trip

LONGEST_S = 10
ENVELOPE, LEAST_ENVELOPE = 0.95, 0.8
ONSET_MS = 5.0
SOUNDS = Path(__file__).resolve().parents[2] / ".cache/sounds"


@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_a_scene_comes_back_with_its_envelope_and_its_onsets(profile: str, tmp_path: Path) -> None:
    for name, found in round_trip(scene(), RATE_HZ, profile, tmp_path).items():
        assert found.envelope >= ENVELOPE, name
        assert len(found.onset_errors_ms) >= 1, name
        assert max(map(abs, found.onset_errors_ms)) <= ONSET_MS, name


def test_partial_tracks_come_back_as_the_wave_itself(tmp_path: Path) -> None:
    exported(scene(), tmp_path / "v.wav", "wav", output_rate_hz=PLAYED_HZ)
    original = read_wave(tmp_path / "v.wav")[0][:, 0]
    exported(scene(), tmp_path / "partials", "partials")
    content = (tmp_path / "partials").read_bytes()
    made = RENDERERS["partials"](content, original.size / PLAYED_HZ, PLAYED_HZ)
    error_db = 20 * np.log10(np.std(made - original) / np.std(original))
    assert error_db < -20.0  # phases are right: a wrong one gives +3 dB


@pytest.mark.soak
@pytest.mark.skipif(not SOUNDS.is_dir(), reason="no sounds: run tools/fetch_sounds.sh")
@pytest.mark.parametrize("profile", ["paper", "cinema"])
@pytest.mark.parametrize("kind", sorted(one.name for one in SOUNDS.glob("*")) or ["none"])
def test_real_sounds_come_back(kind: str, profile: str, tmp_path: Path) -> None:
    errors: dict[str, list[float]] = {name: [] for name in RENDERERS}
    alike: dict[str, list[bool]] = {name: [] for name in RENDERERS}
    files = sorted((SOUNDS / kind).iterdir())
    assert files
    for file in files:
        with soundfile.SoundFile(file) as opened:
            sound = opened.read(LONGEST_S * opened.samplerate, dtype="float32", always_2d=True)
            rate_hz = opened.samplerate
        for name, found in round_trip(sound, rate_hz, profile, tmp_path).items():
            assert found.envelope >= LEAST_ENVELOPE, f"{file.name} as {name}"
            alike[name].append(found.envelope >= ENVELOPE)
            errors[name] += found.onset_errors_ms
    for name, found_ms in errors.items():
        assert np.mean(alike[name]) >= 0.9, name
        assert not found_ms or np.mean(np.abs(found_ms) <= ONSET_MS) >= 0.9, name

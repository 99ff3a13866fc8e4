"""WAV and FLAC at any rate hold the same vibration, in a fraction of the bytes."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import czt

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.export import ExportOptions, export
from audioflinger_hook.exports.sound_output import BackgroundOutput, LeakMeter, ResampledOutput
from audioflinger_hook.offline.render import render
from device.errors import WriteError
from device.wav_output import WavOutput
from tests.support.exports import RATE_HZ, client_of, exported, read_wave, scene
from tests.support.outputs import KeptOutput
from tests.support.signals import tone


def spectrum(vibration: Any, rate_hz: int) -> Any:
    """Return the Fourier transform from 20 to 220 Hz, in steps of 0.1 Hz."""
    turn = np.exp(-2j * np.pi * 0.1 / rate_hz)
    return czt(vibration, 2_000, turn, np.exp(2j * np.pi * 20.0 / rate_hz)) / rate_hz


@pytest.mark.parametrize("channels", ["mono", "each"])
@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_wav_at_its_rate_is_what_render_writes(channels: Any, profile: str, tmp_path: Path) -> None:
    sound, settings = scene(channels=2), Settings(profile=profile, channels=channels)
    rendered = render(client_of(sound), tmp_path / "r.wav", settings)
    report = export(client_of(sound), tmp_path / "e.wav", settings, ExportOptions("wav"))
    assert (tmp_path / "e.wav").read_bytes() == (tmp_path / "r.wav").read_bytes()
    assert (report.frames, report.peak) == (rendered.frames, rendered.peak)


@pytest.mark.parametrize("name", ["wav", "flac"])
@pytest.mark.parametrize("rate_hz", [48_000, 44_100, 8_000])
def test_1_khz_holds_it_in_a_fortieth_of_the_bytes(name: str, rate_hz: int, tmp_path: Path) -> None:
    sound = scene(3.0)[:: 6 if rate_hz == 8_000 else 1]
    exported(sound, tmp_path / "full.wav", "wav", rate_hz)
    report = exported(sound, tmp_path / "low", name, rate_hz, output_rate_hz=1_000)
    full, _ = read_wave(tmp_path / "full.wav")
    low, low_hz = read_wave(tmp_path / "low")
    assert low_hz == report.samplerate == 1_000
    assert len(low) == report.frames == -(-len(sound) * 1_000 // rate_hz)
    wanted, found = spectrum(full[:, 0], rate_hz), spectrum(low[:, 0], low_hz)
    assert np.sum(np.abs(wanted - found) ** 2) <= 1e-6 * np.sum(np.abs(wanted) ** 2)
    float_bytes = 4 * 48_000 * len(sound) / rate_hz
    assert report.bytes <= float_bytes / 40


@pytest.mark.parametrize("output_rate_hz", [1_000, 1_333, 96_000])
def test_resampling_does_not_depend_on_the_blocks(output_rate_hz: int, tmp_path: Path) -> None:
    vibration = np.random.default_rng(3).standard_normal((20_000, 2))
    path, contents = tmp_path / "out.wav", set()
    for cuts in ([], [1, 5_000], [7_001, 14_002]):
        output = ResampledOutput(WavOutput(path, output_rate_hz, 2), RATE_HZ)
        for block in np.split(vibration, cuts):
            output.write(block)
        output.close()
        contents.add(path.read_bytes())
    assert len(contents) == 1


def test_flac_keeps_24_bits_and_counts_what_it_limits(tmp_path: Path) -> None:
    sound = tone(200.0, 1.0, RATE_HZ)[:, None].astype(np.float32)
    wav, flac = (
        exported(sound, tmp_path / name, name, profile="paper", form="reference")
        for name in ("wav", "flac")
    )
    full, low = read_wave(tmp_path / "wav")[0], read_wave(tmp_path / "flac")[0]
    assert np.abs(np.clip(full, -1, 1) - low).max() <= 2.0**-22
    assert (flac.limited_samples, wav.limited_samples) == (int((np.abs(full) > 1.0).sum()), 0)


@pytest.mark.parametrize(("hz", "leak_db"), [(100.0, -75.0), (220.0, -60.0), (400.0, -0.2)])
def test_a_leak_meter_tells_what_is_over_250_hz(hz: float, leak_db: float, tmp_path: Path) -> None:
    meter = LeakMeter(WavOutput(tmp_path / "out.wav", RATE_HZ, 1))
    time_s = np.arange(4 * RATE_HZ) / RATE_HZ
    # raised and lowered slowly, for a step has energy everywhere
    shape = np.sin(np.pi * time_s / 4.0) ** 2
    meter.write((shape * tone(hz, 4.0, RATE_HZ))[:, None])
    meter.close()
    assert meter.leak_db is not None
    assert meter.leak_db >= leak_db if hz > 250.0 else meter.leak_db <= leak_db
    assert meter.leak_db <= 0.01


def test_the_leak_does_not_depend_on_the_blocks_or_the_length() -> None:
    """A sound of 400 s uses the transform for long sounds from about its middle on."""
    rate_hz, seconds = 1_000, 400
    sound = (tone(100.0, seconds, rate_hz) + 1e-3 * tone(400.0, seconds, rate_hz))[:, None]
    sound *= np.sin(np.pi * np.arange(len(sound)) / len(sound))[:, None] ** 2

    def leak_db(block: int) -> float:
        meter = LeakMeter(KeptOutput(rate_hz, 1))
        for first in range(0, len(sound), block):
            meter.write(sound[first : first + block])
        meter.close()
        assert meter.leak_db is not None
        return meter.leak_db

    assert leak_db(997) == pytest.approx(-60.0, abs=1e-3)
    assert leak_db(997) == pytest.approx(leak_db(len(sound)), abs=1e-9)


@given(frames=st.integers(200, 3_000))
def test_a_leak_counts_alike_at_the_start_and_at_the_end(frames: int) -> None:
    sound = np.concatenate((tone(400.0, 0.1, 1_000), np.zeros(frames - 100)))[:, None]
    sound += 0.1 * tone(100.0, frames / 1_000, 1_000)[:frames, None]
    leaks = []
    for direction in (1, -1):
        meter = LeakMeter(KeptOutput(1_000, 1))
        meter.write(sound[::direction])
        meter.close()
        leaks.append(meter.leak_db)
    assert leaks[0] == pytest.approx(leaks[1], abs=0.05)


def test_blocks_are_encoded_in_order_on_one_other_thread_which_reports_errors() -> None:
    numbers, threads = list[float](), set[int]()

    class Encoder(KeptOutput):
        def write(self, vibration: Any) -> None:
            threads.add(threading.get_ident())
            if len(numbers) == 3:
                raise WriteError("full")
            numbers.append(float(vibration[0, 0]))

    output, block = BackgroundOutput(Encoder(RATE_HZ, 1)), np.zeros((9, 1))

    def play() -> None:
        for number in range(99):
            block[:] = number
            output.write(block)

    with pytest.raises(WriteError, match="full"):
        play()
    output.abort()
    assert numbers == [0.0, 1.0, 2.0]
    assert len(threads - {threading.get_ident()}) == len(threads) == 1


def test_silence_has_no_leak(tmp_path: Path) -> None:
    report = exported(np.zeros((4_800, 1), np.float32), tmp_path / "a.wav", "wav")
    assert (report.leak_above_250_hz_db, report.peak) == (None, 0.0)

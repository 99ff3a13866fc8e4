import json
import re
import threading
from pathlib import Path
from typing import Any

import mutagen.oggvorbis
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import czt

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports import ahap, haptic_clip, parametric, tracks, vibration_xml
from audioflinger_hook.exports.decimals import decimal_text, point_texts
from audioflinger_hook.exports.export import ExportOptions, export
from audioflinger_hook.exports.glides import Onset, VibrationCurve, low_pass
from audioflinger_hook.exports.hjif import effects_of
from audioflinger_hook.exports.options import FORMATS
from audioflinger_hook.exports.sound_output import BackgroundOutput, LeakMeter, ResampledOutput
from audioflinger_hook.exports.tracks import PartialTrack
from audioflinger_hook.offline.render import render
from device.errors import UsageError, WriteError
from device.wav_output import WavOutput
from tests.support.exports import RATE_HZ, check, client_of, exported, read_wave, scene
from tests.support.outputs import KeptOutput
from tests.support.signals import tone

PARAMETRIC = [name for name, one in FORMATS.items() if one.parametric]


@pytest.mark.parametrize("name", PARAMETRIC)
@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_a_scene_gives_a_file_that_keeps_the_rules(name: str, profile: str, tmp_path: Path) -> None:
    report = exported(scene(), tmp_path / "out", name, profile=profile)
    check(name, (tmp_path / "out").read_bytes())
    assert report.bytes == (tmp_path / "out").stat().st_size
    assert report.peak > 0.0


@pytest.mark.parametrize("name", PARAMETRIC)
@pytest.mark.parametrize("level", [0.0, 1.0])
def test_short_sounds_and_silence_keep_the_rules(name: str, level: float, tmp_path: Path) -> None:
    for frames in (1, 47, 4_801):
        exported(np.full((frames, 1), level, np.float32), tmp_path / "out", name)
        check(name, (tmp_path / "out").read_bytes())


levels = st.lists(st.floats(0.0, 1.3), min_size=1, max_size=400)
frequencies = st.lists(st.floats(15.0, 230.0), min_size=1, max_size=20)


@st.composite
def curves(draw):
    """Random levels, each held for some samples, with onsets anywhere, 0.06 s apart or more."""
    rate, repeats = draw(st.sampled_from([500.0, 525.0])), draw(st.sampled_from([1, 3, 40]))
    amplitude, hz = np.repeat(np.array(draw(levels), np.float32), repeats), draw(frequencies)
    at_hz = np.resize(np.repeat(np.array(hz, np.float32), 9), amplitude.size)
    found: list[Onset] = []
    for share in sorted(draw(st.lists(st.floats(0.0, 1.0), max_size=12))):
        time_s = share * amplitude.size / rate
        if time_s > 0.0 and (not found or time_s - found[-1].time_s >= 0.06):
            found.append(Onset(time_s, hz[0]))
    return VibrationCurve(rate, 0.0, amplitude, at_hz, tuple(found))


@pytest.mark.parametrize("kind", [ahap, haptic_clip, vibration_xml])
@settings(max_examples=60, deadline=None)
@given(curve=curves(), band=st.sampled_from([None, (55.0, 200.0)]))
def test_any_curve_keeps_the_rules(kind, curve, band):
    content, composed = kind.compose(curve, curve.amplitude.size / curve.rate_hz, band)
    name = {ahap: "ahap", haptic_clip: "haptic", vibration_xml: "vibration-xml"}[kind]
    check(name, content)
    assert all(np.isfinite(value) for value in composed.error.values())


@pytest.mark.parametrize("name", PARAMETRIC)
def test_a_device_band_moves_all_frequencies_into_it(name: str, tmp_path: Path) -> None:
    exported(scene(), tmp_path / "out", name, device_band_hz=(80.0, 230.0))
    content = (tmp_path / "out").read_bytes()
    check(name, content)
    if name == "partials":
        lines = [json.loads(line) for line in content.splitlines()]
        hz = [point[1] for line in lines if line["type"] == "track" for point in line["points"]]
        assert 80.0 <= min(hz) <= max(hz) <= 230.0
    if name == "hjif":
        whole_hz = re.findall(rb'"frequency_modulation":(\d+)', content)
        assert whole_hz
        assert all(80 <= int(hz) <= 230 for hz in whole_hz)


@given(st.lists(st.floats(-2.0, 9_000.0), min_size=1, max_size=50), st.integers(1, 7))
def test_numbers_have_the_digits_of_rounded_floats(numbers: list[float], places: int) -> None:
    numbers += [one * 10.0**-place for one in numbers for place in (3, 5, 7)]
    column, rounded = np.array(numbers), np.round(numbers, places).tolist()
    (texts,) = point_texts([decimal_text(column, places)] * 2, np.array([column.size]))
    expected = json.dumps([[one, one] for one in rounded], separators=(",", ":"))
    assert b"[%b]" % texts == expected.encode()


def test_tracks_computed_together_are_those_of_tracks_alone(tmp_path, monkeypatch):
    rng, passes, contents = np.random.default_rng(4), list[int](), set[bytes]()
    sound = np.hstack((scene(3.0), 0.1 * rng.standard_normal((3 * RATE_HZ, 1)).astype(np.float32)))

    def counted(design: Any, signal: Any, state: Any) -> Any:
        passes[-1] += 1
        return low_pass(design, signal, state)

    monkeypatch.setattr(tracks, "low_pass", counted)
    for together in (0.0, 2.0, parametric.TOGETHER_S):
        passes.append(0)
        monkeypatch.setattr(parametric, "TOGETHER_S", together)
        exported(sound, tmp_path / "out", "partials", channels="each")
        contents.add((tmp_path / "out").read_bytes())
    assert len(contents) == 1
    assert passes[-1] < 0.3 * passes[0]  # which are much of the time


@pytest.mark.parametrize("turns", [0.0, 0.2499999, 0.7499999, 0.75])
def test_phases_of_hjif_stay_under_a_whole_turn(turns: float) -> None:
    times, ones = np.linspace(0.0, 3.0, 31), np.ones(31)
    track = PartialTrack(0, False, times, 100 * ones, ones, turns + 100 * times)
    effects = effects_of(track)
    assert all(0.0 <= one["phase"] <= 6.28318 for one in effects)
    assert effects[-1]["position"] + effects[-1]["keyframes"][-1]["relative_position"] == 3_000


@pytest.mark.parametrize("channels", ["mono", "each"])
def test_ogg_has_the_sound_first_and_the_vibration_last(channels: Any, tmp_path: Path) -> None:
    sound = scene(channels=2)
    sound[:, 1] *= 0.25
    exported(sound, tmp_path / "out.ogg", "ogg-haptic", channels=channels)
    exported(sound, tmp_path / "out.wav", "wav", channels=channels)
    vibration, _ = read_wave(tmp_path / "out.wav")
    # libsndfile keeps the order of the bitstream, as Android does
    frames, rate_hz = read_wave(tmp_path / "out.ogg")
    assert (frames.shape, rate_hz) == ((len(sound), 2 + vibration.shape[1]), RATE_HZ)
    wanted = np.hstack((sound, vibration))
    for column in range(wanted.shape[1]):
        error = np.std(frames[:, column] - wanted[:, column]) / np.std(wanted[:, column])
        assert error < 0.1  # Vorbis is lossy; another channel would give more than 0.5
    tags = mutagen.oggvorbis.OggVorbis(tmp_path / "out.ogg")
    assert tags["ANDROID_HAPTIC"] == [str(vibration.shape[1])]
    assert tags.info is not None
    assert tags.info.length == pytest.approx(len(sound) / RATE_HZ)


@pytest.mark.parametrize("name", [name for name, one in FORMATS.items() if one.channels_max == 1])
def test_a_format_of_one_channel_refuses_two(name: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot hold 2 channels.*allowed: 1 to 1"):
        exported(scene(0.1, channels=2), tmp_path / "out", name, channels="each")
    assert not (tmp_path / "out").exists()


def test_transients_of_ahap_undo_what_the_curve_takes_from_them(tmp_path: Path) -> None:
    exported(scene(), tmp_path / "out", "ahap")
    pattern = json.loads((tmp_path / "out").read_bytes())["Pattern"]
    events = [one["Event"] for one in pattern if "Event" in one]
    transients = [one["Time"] for one in events if one["EventType"] == "HapticTransient"]
    assert transients
    curves = [one["ParameterCurve"] for one in pattern if "ParameterCurve" in one]
    starts = {
        one["Time"]: one["ParameterCurveControlPoints"][0]["ParameterValue"]
        for one in curves
        if one["ParameterID"] == "HapticIntensityControl"
    }
    # A curve begins with every transient, and its value there is no less than the pulse.
    assert all(starts[time_s] > 0.0 for time_s in transients)


def spectrum(vibration: Any, rate_hz: int) -> Any:
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

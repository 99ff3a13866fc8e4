"""Every format is what its readers take, and keeps its limits for any vibration."""

import json
import re
from pathlib import Path
from typing import Any

import mutagen.oggvorbis
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.exports import ahap, haptic_clip, parametric, tracks, vibration_xml
from audioflinger_hook.exports.decimals import decimal_text, point_texts
from audioflinger_hook.exports.glides import Onset, VibrationCurve, low_pass
from audioflinger_hook.exports.hjif import effects_of
from audioflinger_hook.exports.options import FORMATS
from audioflinger_hook.exports.tracks import PartialTrack
from device.errors import UsageError
from tests.support.exports import RATE_HZ, check, exported, read_wave, scene

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

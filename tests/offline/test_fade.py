import itertools
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.inspection import inspect_file, inspect_tap
from audioflinger_hook.offline.render import render, render_file
from audioflinger_hook.sources import FileTap, TapClient
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.drive.outputs import FADE_S, FadedOutput
from device.errors import UsageError
from device.rig import rig_by_name
from device.rig.simulated_rig import SimulatedRig
from tests.support.commands import RATE, noise, open_files, sound, vibration
from tests.support.outputs import KeptOutput
from tests.support.reference_oracle import oracle_units
from tests.support.signals import FORMS, FloatArray, columns, five_tones, joined, silence, tone
from tests.support.taps import frames_of

FADE = round(FADE_S * RATE)


def rendered(source: Path, out: Path, settings: Settings, fade_s: float = FADE_S) -> FloatArray:
    render(TapClient(FileTap(source)), out, settings, fade_s=fade_s)
    return vibration(out).astype(np.float64)


def gains(frames: int) -> FloatArray:
    share = (np.arange(frames)[:, None] + 0.5) / max(1, frames)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * share))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("profile", PROFILES)
def test_only_the_last_5_ms_are_lower_and_the_last_sample_is_nearly_0(tmp_path, form, profile):
    source = sound(tmp_path / "in.wav", tone(300, 0.3, RATE, 0.5))
    settings = Settings(form=form, profile=profile, parameters=parameters_of(profile))
    whole = rendered(source, tmp_path / "whole.wav", settings, fade_s=0.0)
    faded = rendered(source, tmp_path / "faded.wav", settings)
    assert faded.shape == whole.shape == (round(0.3 * RATE), 1)
    assert np.array_equal(faded[:-FADE], whole[:-FADE])
    np.testing.assert_allclose(faded[-FADE:], gains(FADE) * whole[-FADE:], atol=1e-7)
    assert np.abs(whole[-FADE:]).max() > 0.05
    assert np.abs(faded[-1]) < 2e-5


@pytest.mark.parametrize("form", FORMS)
def test_a_file_shorter_than_the_fade_keeps_its_length(tmp_path, form):
    for frames in (1, 2, 100, FADE - 1, FADE, FADE + 1):
        source = sound(tmp_path / "in.wav", np.full(frames, 0.9))
        got = rendered(source, tmp_path / "out.wav", Settings(form=form))
        assert got.shape == (frames, 1)
        assert np.isfinite(got).all()
        whole = rendered(source, tmp_path / "whole.wav", Settings(form=form), fade_s=0.0)
        assert np.abs(got[-1]) <= 0.5 * np.abs(whole[-1]) + 1e-9


def test_the_acceleration_is_that_of_the_faded_vibration(tmp_path):
    source = sound(tmp_path / "in.wav", tone(300, 0.3, RATE, 0.5))
    out, felt = tmp_path / "out.wav", tmp_path / "felt.wav"
    report = render_file(source, out, Settings(model="linear"), acceleration=felt)
    kept = KeptOutput(RATE)
    rig = SimulatedRig(rig_by_name("paper"), RATE, 1, recorder=kept)
    rig.write(vibration(out))
    rig.close()
    np.testing.assert_allclose(vibration(felt), kept.whole, atol=1e-6)
    assert report.peak == pytest.approx(np.abs(vibration(out)).max())


def test_a_delayed_actuator_ends_with_the_fade_as_well(tmp_path):
    source = sound(tmp_path / "in.wav", tone(300, 0.3, RATE, 0.5))
    settings = Settings(actuators=(ActuatorSettings((0,), delay_ms=20.0),))
    got = rendered(source, tmp_path / "out.wav", settings)
    assert np.abs(got[-1]).max() < 2e-5
    assert np.abs(got[-2 * FADE : -FADE]).max() > 0.1


@given(st.integers(0, 40), st.lists(st.integers(0, 60), max_size=8), st.integers(1, 3))
def test_no_sample_depends_on_the_blocks_and_none_is_lost(fade, lengths, channels):
    frames = np.random.default_rng(1).uniform(-1, 1, (sum(lengths), channels))
    kept = KeptOutput(RATE, channels)
    output = FadedOutput(kept, fade)
    for block in np.split(frames, np.cumsum(lengths)[:-1]) if lengths else []:
        before = block.copy()
        output.write(block)
        assert np.array_equal(block, before)
    output.close()
    faded, whole = min(fade, len(frames)), frames.copy()
    whole[len(frames) - faded :] *= gains(faded)
    np.testing.assert_allclose(kept.whole, whole, atol=1e-6)
    assert kept.ended == ["closed"]
    assert output.peak == pytest.approx(np.abs(whole).max(initial=0.0))


def test_an_aborted_file_gets_nothing_more():
    kept = KeptOutput(RATE)
    output = FadedOutput(kept, FADE)
    output.write(np.ones((2 * FADE, 1)))
    output.abort()
    assert (len(kept.whole), kept.ended) == (FADE, ["aborted"])


WINDOW = 2_229  # frames of a unit at 48 kHz
FRAMES = RATE // 2  # of the sound that most tests look at


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Half a second of stereo: tones, noise, silence; its last unit is not whole."""
    mono = joined(five_tones(0.2, RATE), noise(RATE // 10)[:, 0], silence(0.2, RATE))
    return sound(tmp_path_factory.mktemp("sound") / "in.wav", columns(mono, 0.3 * mono))


def assert_same(units, oracle):
    assert [unit.unit for unit in units] == list(range(len(oracle)))
    for unit, expected in zip(units, oracle, strict=True):
        found, wanted = (
            [(p.audio_hz, p.amplitude, p.bandwidth_hz, p.r, p.vibration_hz) for p in principal]
            for principal in (unit.principal, expected)
        )
        assert np.shape(found) == np.shape(wanted)
        # Both work in float64; 1e-6 is far above its rounding and far below what is printed.
        assert np.allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_units_are_what_an_independent_implementation_finds_of_any_parameters(source):
    samples, samplerate = soundfile.read(source)
    assert_same(list(inspect_file(source)), oracle_units(samples, samplerate))
    samples, samplerate = soundfile.read(source)
    changed: dict[str, Any] = {"window_s": 0.03, "band_low_hz": 80.0, "vibration_top_hz": 180.0}
    parameters = TransformParameters(**changed, partials_max=5, threshold_hz=0.1)
    found = list(inspect_file(source, parameters))
    assert_same(found, oracle_units(samples, samplerate, **changed, partials_max=5, threshold=0.1))
    assert max(len(unit.principal) for unit in found) == 5


@pytest.mark.exhaustive
@pytest.mark.parametrize("blocksize", [1, 7, 1_000, WINDOW, 2 * WINDOW + 1, 10**6])
def test_the_blocksize_changes_nothing(source, blocksize):
    expected = list(inspect_file(source))
    with closing(FileTap(source, blocksize)) as tap:
        assert list(inspect_tap(tap, TransformParameters())) == expected
    with closing(FileTap(source, blocksize)) as tap:
        assert list(inspect_tap(tap, TransformParameters(), at_s=0.25)) == [expected[5]]


def test_no_more_is_read_than_a_unit_needs(source):
    with closing(FileTap(source, blocksize=100)) as tap:
        (unit,) = inspect_tap(tap, TransformParameters(), at_s=0.1)
        assert unit.unit == 2
        assert len(frames_of(tap)) == pytest.approx(FRAMES - 3 * WINDOW, abs=100)
    with closing(FileTap(source, blocksize=WINDOW)) as tap:
        assert next(inspect_tap(tap, TransformParameters())).unit == 0
        assert len(frames_of(tap)) == FRAMES - WINDOW


def test_every_moment_belongs_to_the_unit_that_holds_it(source):
    expected = list(inspect_file(source))
    assert len(expected) == -(-FRAMES // WINDOW)
    for frame in (0, 1, WINDOW - 1, WINDOW, 5 * WINDOW + 3, FRAMES - 1):
        for share in (0.1, 0.5, 0.75):  # of the time until the next frame
            (unit,) = inspect_file(source, at_s=(frame + share) / RATE)
            assert unit == expected[frame // WINDOW]
            assert unit.start_s == pytest.approx(unit.unit * WINDOW / RATE)


@pytest.mark.parametrize("at_s", [0.5, 1.5, 1e9, 1e308, np.inf, -np.inf, np.nan, -1e-9])
def test_a_moment_outside_the_sound_is_the_users_mistake(source, at_s):
    with pytest.raises(UsageError, match=r"time \S+ s is .*; allowed: 0"):
        list(inspect_file(source, at_s=at_s))


def test_whoever_stops_early_leaves_no_file_open(source):
    before = open_files()
    for _ in range(3):
        assert len(list(itertools.islice(inspect_file(source), 2))) == 2
    assert open_files() == before

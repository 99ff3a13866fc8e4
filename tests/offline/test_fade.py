from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render, render_file
from audioflinger_hook.sources import FileTap, TapClient
from device.drive import ActuatorSettings
from device.drive.outputs import FADE_S, FadedOutput
from device.rig import rig_by_name
from device.rig.simulated_rig import SimulatedRig
from tests.support.commands import RATE, sound, vibration
from tests.support.outputs import KeptOutput
from tests.support.signals import FORMS, FloatArray, tone

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

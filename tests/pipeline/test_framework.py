"""The framework as one: its vibration is the transform's, whoever plays and whatever fails."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.pipeline.framework import OFFLINE_HAL_FRAMES, Framework
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import FramesTap, SceneClient, TapClient
from audioflinger_hook.transform import HapticTransform, TransformParameters
from device.errors import InternalError, UsageError
from tests.support.commands import call, listing, refused, sound
from tests.support.pipelines import RATE, UnevenTap, music, steps_of, transformed
from tests.support.signals import FORMS

MODES = ("mono", "each")


# --- what is felt


@settings(max_examples=40)
@given(
    st.sampled_from(FORMS),
    st.sampled_from(MODES),
    st.sampled_from([1, 2, 3]),
    st.lists(st.one_of(st.just(0), st.integers(1, 3_000)), max_size=15),
)
def test_the_vibration_is_the_transforms_and_the_sound_unchanged_bit_for_bit(
    form, mode, channels, lengths
):
    frames = music(12_000, channels)
    framework = Framework(RATE, channels, Settings(form=form, channels=mode))
    audio, vibration = steps_of(TapClient(UnevenTap(frames, lengths)), framework)
    alone = transformed(frames, form=form, per_channel=mode == "each")
    assert vibration.dtype == np.float32
    assert vibration.tobytes() == alone.tobytes()
    assert np.abs(vibration).max() > 0.05
    assert audio.tobytes() == frames.tobytes()
    assert framework.bypassed() == []
    assert framework.replaced_samples == 1


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 192_000])
@pytest.mark.parametrize("form", FORMS)
def test_so_it_is_at_every_rate_and_in_long_cycles(samplerate, form):
    frames = music(samplerate // 4)
    framework = Framework(samplerate, 2, Settings(form=form), hal_frames=OFFLINE_HAL_FRAMES)
    _, vibration = steps_of(TapClient(FramesTap(frames, samplerate, 50_000)), framework)
    assert vibration.tobytes() == transformed(frames, samplerate, form=form).tobytes()


@pytest.mark.parametrize("form", FORMS)
def test_the_declared_latency_is_by_how_much_the_transform_is_late(form):
    parameters = TransformParameters(window_s=0.07)
    framework = Framework(RATE, 2, Settings(form=form, parameters=parameters))
    transform = HapticTransform(RATE, 2, parameters, form=form)
    assert framework.latency_frames == transform.latency_frames
    assert framework.latency_s == transform.latency_frames / RATE
    frames = music(5_000)
    _, vibration = steps_of(TapClient(FramesTap(frames, RATE, 777)), framework)
    assert vibration.tobytes() == transformed(frames, parameters=parameters, form=form).tobytes()


def test_only_what_a_device_gets_is_cut_to_full_scale():
    peaks = {}
    loud = music(24_000, level=5.0)
    for form in FORMS:
        _, vibration = steps_of(
            TapClient(FramesTap(loud, RATE, 500)), Framework(RATE, 2, Settings(form=form))
        )
        assert vibration.tobytes() == transformed(loud, form=form).tobytes()
        peaks[form] = np.abs(vibration).max()
    assert peaks["live"] < 1.0 < peaks["reference"]


def test_a_band_that_the_rate_cannot_hold_is_refused_in_the_transforms_own_words():
    chosen = TransformParameters(band_low_hz=600.0, band_high_hz=2_000.0)
    for form in FORMS:
        with pytest.raises(UsageError) as own:
            HapticTransform(1_000, 2, chosen, form=form)
        with pytest.raises(UsageError) as found:
            Framework(1_000, 2, Settings(form=form, parameters=chosen))
        assert str(found.value) == str(own.value)
        assert "band_low_hz=600" in str(found.value)


# --- when our own effect fails


def failing_after(buffers, monkeypatch):
    """Make every transform raise from its so-manyth block on."""
    process, seen = HapticTransform.process, itertools.count()

    def fail(self, audio):
        if next(seen) >= buffers:
            raise ArithmeticError("nothing adds up")
        return process(self, audio)

    monkeypatch.setattr(HapticTransform, "process", fail)


@pytest.mark.parametrize("buffers", [0, 1])
def test_a_rendering_whose_effect_fails_is_an_internal_error_and_leaves_no_file(
    tmp_path, monkeypatch, buffers
):
    source = sound(tmp_path / "in.wav", music(100_000))
    (tmp_path / "out.wav").write_bytes(b"old")
    before = listing(tmp_path)
    failing_after(buffers, monkeypatch)
    with pytest.raises(InternalError, match="failed: raised ArithmeticError: nothing adds up"):
        render_file(source, tmp_path / "out.wav", acceleration=tmp_path / "felt.wav")
    assert listing(tmp_path) == before
    done = call("render", source, tmp_path / "new.wav")
    assert "the haptic effect failed" in refused(done, 5)
    assert listing(tmp_path) == before


def test_the_sound_goes_on_and_the_vibration_rests_where_our_effect_fails(monkeypatch):
    frames = music(4_800)
    framework = Framework(RATE, 2)
    chain = Pipeline(TapClient(FramesTap(frames, RATE, 480)), framework, ())
    failing_after(4, monkeypatch)
    for first in range(0, 4_800, 480):
        step = chain.step()
        assert step
        assert step.audio.tobytes() == frames[first : first + 480].tobytes()
        assert first < 4 * 480 or not step.vibration.any()
    (bypassed,) = framework.bypassed()
    assert bypassed.startswith("session 0, Haptic Cushion: raised ArithmeticError")
    with pytest.raises(InternalError):
        chain.step()


# --- the dump


def test_the_dump_holds_thread_tracks_chain_and_effect():
    framework = Framework(RATE, 2, Settings(channels="each"))
    chain = Pipeline(SceneClient(demo_scene()), framework, ())
    for cycle in range(200):
        chain.step(cycle * 256 / RATE)
    lines = [line.strip() for line in framework.dump([0.001, 0.002]).splitlines()]
    for expected in (
        "Haptic channel count: 2",
        f"Frames written: {200 * 256}",
        "5 Tracks of which 1 are active",
        "Effect 0: Haptic Cushion",
        f"- latency_frames: {framework.latency_frames} frames",
        "- per_channel: True",
        "- clip: True",
    ):
        assert expected in lines, expected
    assert any(line.startswith("Cycle time of 2 cycles") for line in lines)

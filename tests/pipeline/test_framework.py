import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.pipeline.framework import (
    OFFLINE_HAL_FRAMES,
    Framework,
    channel_map_of,
    drive_of,
    simulated_rig_of,
)
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.sources import FramesTap, TapClient
from audioflinger_hook.transform import HapticTransform, TransformParameters
from device.drive import ActuatorSettings, ChannelMap
from device.errors import InternalError, UsageError
from device.rig import CONSUMER, PAPER
from device.rig.simulated_rig import SimulatedRig
from tests.support.commands import call, listing, refused, sound
from tests.support.pipelines import RATE, music, steps_of, transformed
from tests.support.signals import FORMS
from tests.support.taps import cut

MODES = ("mono", "each")


@settings(max_examples=40)
@given(
    st.sampled_from(FORMS),
    st.sampled_from(MODES),
    st.sampled_from([1, 2, 3]),
    st.lists(st.one_of(st.just(0), st.integers(1, 3_000)), max_size=15),
)
def test_the_vibration_is_the_transforms_and_the_sound_the_same_bits(form, mode, channels, lengths):
    frames = music(12_000, channels)
    framework = Framework(RATE, channels, Settings(form=form, channels=mode))
    audio, vibration = steps_of(TapClient(cut(frames, lengths)), framework)
    alone = transformed(frames, form=form, per_channel=mode == "each")
    assert vibration.tobytes() == alone.tobytes()
    assert np.abs(vibration).max() > 0.05
    assert (audio.tobytes(), framework.bypassed()) == (frames.tobytes(), [])
    assert framework.replaced_samples == 1


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 192_000])
@pytest.mark.parametrize("form", FORMS)
def test_vibration_and_declared_latency_are_so_at_every_rate_and_in_long_cycles(samplerate, form):
    options = {"form": form, "parameters": TransformParameters(window_s=0.07)}
    framework = Framework(samplerate, 2, Settings(**options), hal_frames=OFFLINE_HAL_FRAMES)
    latency_frames = HapticTransform(samplerate, 2, **options).latency_frames
    assert framework.latency_frames == latency_frames
    assert framework.latency_s == latency_frames / samplerate
    frames = music(samplerate // 4)
    _, vibration = steps_of(TapClient(FramesTap(frames, samplerate, 50_000)), framework)
    assert vibration.tobytes() == transformed(frames, samplerate, **options).tobytes()


def test_only_what_a_device_gets_is_cut_to_full_scale():
    peaks, loud = [], music(24_000, level=5.0)
    for form in ("live", "reference"):
        framework = Framework(RATE, 2, Settings(form=form))
        _, vibration = steps_of(TapClient(FramesTap(loud, RATE, 500)), framework)
        assert vibration.tobytes() == transformed(loud, form=form).tobytes()
        peaks.append(np.abs(vibration).max())
    assert peaks[0] < 1.0 < peaks[1]


def test_a_band_that_the_rate_cannot_hold_is_refused_in_the_transforms_own_words():
    chosen = TransformParameters(band_low_hz=600.0, band_high_hz=2_000.0)
    for form in FORMS:
        with pytest.raises(UsageError) as own:
            HapticTransform(1_000, 2, chosen, form=form)
        with pytest.raises(UsageError) as found:
            Framework(1_000, 2, Settings(form=form, parameters=chosen))
        assert str(found.value) == str(own.value)
        assert "band_low_hz=600" in str(found.value)


def failing_after(buffers, monkeypatch):
    """Make every transform raise from its so-manyth block on."""
    process, seen = HapticTransform.process, itertools.count()

    def fail(self, audio):
        if next(seen) >= buffers:
            raise ArithmeticError("nothing adds up")
        return process(self, audio)

    monkeypatch.setattr(HapticTransform, "process", fail)


@pytest.mark.parametrize("buffers", [0, 1])
def test_a_rendering_whose_effect_fails_is_an_error_without_a_file(tmp_path, monkeypatch, buffers):
    source = sound(tmp_path / "in.wav", music(100_000))
    (tmp_path / "out.wav").write_bytes(b"old")
    before = listing(tmp_path)
    failing_after(buffers, monkeypatch)
    done = call("render", source, tmp_path / "out.wav", "--acceleration", tmp_path / "felt.wav")
    assert "the haptic effect failed: raised ArithmeticError: nothing adds up" in refused(done, 5)
    assert listing(tmp_path) == before


def test_the_sound_goes_on_and_the_vibration_rests_where_our_effect_fails(monkeypatch):
    frames, framework = music(4_800), Framework(RATE, 2)
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


LOW_RATE = 8_000


def test_simulated_rigs_stand_where_the_actuators_are_wired():
    left = ActuatorSettings((2,), "left", rig="consumer")
    settings = Settings(actuators=(left, ActuatorSettings((0,), "right")))
    channel_map = channel_map_of(settings, 2)
    assert channel_map == ChannelMap(2, (1, None, 0))
    vibration = np.random.default_rng(1).uniform(-0.5, 0.5, (500, 3))
    wired = simulated_rig_of(settings, LOW_RATE, channel_map)
    alone = SimulatedRig([PAPER, None, CONSUMER], LOW_RATE, tolerance=settings.tolerance)
    wired.write(vibration)
    alone.write(vibration)
    wired.close()
    alone.close()
    assert len(wired.acceleration_m_s2) == 500
    assert np.array_equal(wired.acceleration_m_s2, alone.acceleration_m_s2)


def test_without_actuators_each_channel_of_the_vibration_has_the_settings_rig():
    settings = Settings(rig="consumer", protection="on")
    channel_map = channel_map_of(settings, 2)
    assert channel_map == ChannelMap(2, (0, 1))
    assert simulated_rig_of(settings, LOW_RATE, channel_map).channels == 2
    drive = drive_of(settings, LOW_RATE, 2)
    assert drive.outputs == 2
    assert drive.processors[0] is not None
    assert drive.processors[0].rig == CONSUMER

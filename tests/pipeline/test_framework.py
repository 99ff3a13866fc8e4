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
from audioflinger_hook.transform import Form, HapticTransform, TransformParameters
from device.errors import InternalError, UsageError
from tests.support.commands import call, listing, refused, sound

RATE = 48_000
FORMS: tuple[Form, ...] = ("live", "reference")
MODES = ("mono", "each")


class UnevenTap:
    """Frames in buffers of the given lengths, then the rest."""

    format_changed = discontinuity = False

    def __init__(self, frames, lengths, samplerate=RATE):
        ends = np.minimum(np.cumsum([0, *lengths]), len(frames))
        self._buffers = [frames[a:b] for a, b in zip(ends, [*ends[1:], len(frames)], strict=True)]
        self.samplerate, self.channels = samplerate, frames.shape[1]
        self.frames_expected = len(frames)

    def read(self):
        return self._buffers.pop(0) if self._buffers else None

    def close(self):
        self._buffers = []


def music(frames, channels=2, seed=0, level=0.3):
    """Noise and tones that come and go, and samples that no transform can use."""
    random = np.random.default_rng(seed)
    seconds = np.arange(frames)[:, None] / RATE
    tones = np.sin(2 * np.pi * 330.0 * seconds) * (np.sin(2 * np.pi * 5.0 * seconds) > 0.0)
    mixed = level * (random.standard_normal((frames, channels)) + 2.0 * tones)
    mixed[frames // 2, 0] = np.nan
    return mixed.astype(np.float32)


def transformed(frames, samplerate=RATE, **options):
    """The vibration by the transform alone, in one block, with what it owes at the end."""
    transform = HapticTransform(samplerate, frames.shape[1], **options)
    whole = np.concatenate((transform.process(frames), transform.finish()))
    assert len(whole) == len(frames) + transform.latency_frames
    return whole.astype(np.float32)


def steps_of(client, framework):
    """Everything that moves through a chain: (sound, vibration)."""
    chain = Pipeline(client, framework, ())
    steps = list(itertools.takewhile(lambda step: step is not None, iter(chain.step, 0)))
    return tuple(
        np.concatenate([getattr(step, name) for step in steps]) for name in ("audio", "vibration")
    )


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


def test_two_frameworks_in_turns_do_not_disturb_one_another():
    sounds = [music(9_000, 2, seed=1), music(9_000, 3, seed=2, level=0.1)]
    choices = [Settings(), Settings(form="reference", channels="each")]
    chains = []
    for frames, chosen in zip(sounds, choices, strict=True):
        framework = Framework(RATE, frames.shape[1], chosen)
        chains.append(Pipeline(TapClient(FramesTap(frames, RATE, 333)), framework, ()))
    felt: list[list[np.ndarray]] = [[], []]
    for _ in range(29):
        for chain, blocks in zip(chains, felt, strict=True):
            if step := chain.step():
                blocks.append(step.vibration)
    assert np.concatenate(felt[0]).tobytes() == transformed(sounds[0]).tobytes()
    each = transformed(sounds[1], form="reference", per_channel=True)
    assert np.concatenate(felt[1]).tobytes() == each.tobytes()


def test_a_band_that_the_rate_cannot_hold_is_refused_in_the_transforms_own_words():
    chosen = TransformParameters(band_low_hz=600.0, band_high_hz=2_000.0)
    for form in FORMS:
        with pytest.raises(UsageError) as own:
            HapticTransform(1_000, 2, chosen, form=form)
        with pytest.raises(UsageError) as found:
            Framework(1_000, 2, Settings(form=form, parameters=chosen))
        assert str(found.value) == str(own.value)
        assert "band_low_hz=600" in str(found.value)


def test_a_format_beyond_the_limits_is_refused():
    for samplerate, channels, words in [
        (999, 2, "samplerate=999 Hz"),
        (768_001, 2, "samplerate=768001 Hz"),
        (RATE, 0, "channels=0"),
        (RATE, 65, "channels=65"),
    ]:
        with pytest.raises(UsageError, match=words):
            Framework(samplerate, channels)


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
        "Output thread (MIXER):",
        "Standby: no",
        "State: ready",
        "Sample rate: 48000 Hz",
        "Haptic channel count: 2",
        f"Frames written: {200 * 256}",
        "5 Tracks of which 1 are active",
        "1 Effect Chains",
        "1 effects for session 0",
        "Effect 0: Haptic Cushion",
        "0       ACTIVE   y       n",
        "Configuration: 48000 Hz, 2 + 2 channels, 960 frames, write",
        f"- latency_frames: {framework.latency_frames} frames",
        "- per_channel: True",
        "- clip: True",
    ):
        assert expected in lines, expected
    (engine,) = [line.split() for line in lines if " engine " in line]
    assert engine[1:8] == ["yes", "engine", "0", "active", "i16", "2", "44100"]
    assert any(line.startswith("Cycle time of 2 cycles") for line in lines)


def test_a_dump_before_the_first_cycle_and_after_the_last_is_one_too():
    framework = Framework(RATE, 1)
    assert "State: idle" in framework.dump()
    assert "Effect 0: Haptic Cushion" in framework.dump()
    steps_of(TapClient(FramesTap(music(5_000, 1), RATE, 700)), framework)
    assert f"Frames written: {5_000}" in framework.dump()

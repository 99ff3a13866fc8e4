import itertools
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.pipeline.framework import (
    OFFLINE_HAL_FRAMES,
    Framework,
    channel_map_of,
    drive_of,
    simulated_rig_of,
)
from audioflinger_hook.pipeline.step import HapticSink, Pipeline
from audioflinger_hook.scenes import Scene, SceneTrack, demo_scene
from audioflinger_hook.sources import FileTap, FramesTap, SceneClient, TapClient, mixdown
from audioflinger_hook.transform import HapticTransform, TransformParameters
from device.drive import ActuatorSettings, ChannelMap
from device.drive.outputs import AlignedOutput
from device.errors import InternalError, UsageError, WriteError
from device.rig import CONSUMER, PAPER
from device.rig.simulated_rig import SimulatedRig
from device.wav_output import WavOutput
from tests.support.commands import call, listing, noise, refused, sound, vibration
from tests.support.outputs import KeptOutput
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


BLOCKSIZES = [240, 1, 7, 256, 4_096, 10**6]


@pytest.fixture(scope="module")
def mix():
    """Half a second of the demo: silence, then the engine, which has peaks of every strength."""
    return mixdown(demo_scene())[12_000:36_000]


@pytest.fixture(scope="module")
def scene(mix):
    return Scene("test", RATE, (SceneTrack("all", RATE, mix, 0.0),), 0.5)


@pytest.fixture(scope="module")
def scene_file(mix, tmp_path_factory):
    return sound(tmp_path_factory.mktemp("scene") / "scene.wav", mix)


@pytest.fixture(scope="module")
def expected(mix):
    """By form, the whole vibration of the scene in one block, its latency taken out."""
    return {form: transformed(mix, form=form)[-len(mix) :] for form in FORMS}


def played(frames, blocksize):
    return TapClient(FramesTap(frames, RATE, blocksize))


def run(client, settings, outputs):
    framework = Framework(client.samplerate, client.channels, settings)
    latency = framework.latency_frames
    chain = Pipeline(client, framework, [AlignedOutput(output, latency) for output in outputs])
    steps = []
    while step := chain.step():
        steps.append(step)
        assert len(steps) < 100_000  # it ends
    assert chain.step() is None
    chain.close()
    return steps


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("blocksize", BLOCKSIZES)
def test_a_file_and_a_scene_in_any_blocksize_give_every_output_the_same_bytes(
    scene, scene_file, mix, expected, tmp_path, form, blocksize
):
    path = tmp_path / "out.wav"
    for client in (TapClient(FileTap(scene_file, blocksize)), SceneClient(scene, blocksize)):
        kept = KeptOutput(RATE)
        steps = run(client, Settings(form=form), [WavOutput(path, RATE, 1), kept])
        assert np.array_equal(np.concatenate([step.audio for step in steps]), mix)
        assert np.array_equal(vibration(path), expected[form])
        assert np.array_equal(kept.whole, expected[form])
        assert kept.ended == ["closed"]


def test_a_step_moves_one_buffer_and_the_last_step_only_what_is_owed(mix):
    framework, output = Framework(RATE, 2), KeptOutput(RATE)
    chain = Pipeline(played(mix, 800), framework, [output])
    steps, owed = list(iter(chain.step, None)), framework.latency_frames
    assert [step.audio.shape for step in steps] == [*[(800, 2)] * 30, (0, 2)]
    assert [step.vibration.shape for step in steps] == [*[(800, 1)] * 30, (owed, 1)]
    assert ([chain.step() for _ in range(3)], len(output.whole)) == ([None] * 3, 24_000 + owed)


@pytest.mark.parametrize("before", [{}, {"out.wav": b"old", "felt.wav": b"older"}])
@pytest.mark.parametrize("steps", [0, 1, 20, 1_000])
def test_abort_leaves_nothing_and_harms_nothing(mix, tmp_path, before, steps):
    for name, content in before.items():
        (tmp_path / name).write_bytes(content)
    recorder = WavOutput(tmp_path / "felt.wav", RATE, 1)
    felt = AlignedOutput(SimulatedRig(PAPER, RATE, 1, recorder=recorder), 10)
    outputs = [AlignedOutput(WavOutput(tmp_path / "out.wav", RATE, 1), 10), felt]
    chain = Pipeline(played(mix, 256), Framework(RATE, 2), outputs)
    for _ in range(steps):
        chain.step()
    chain.abort()
    chain.abort()
    chain.close()  # the first one counts
    assert listing(tmp_path) == before


def test_close_keeps_what_was_sent_and_lets_go_of_the_tap(tmp_path):
    tap = cut(noise(5_000, 2).astype(np.float32), [600, 400])
    chain = Pipeline(TapClient(tap), Framework(RATE, 2), [WavOutput(tmp_path / "a", RATE, 1)])
    chain.step()
    chain.step()
    chain.close()
    chain.close()
    chain.abort()
    assert tap.read() is None
    assert len(vibration(tmp_path / "a")) == 1_000


def test_an_output_that_fails_stops_the_chain_and_abort_discards_the_others(mix, tmp_path):
    whole, clogged = WavOutput(tmp_path / "out.wav", RATE, 1), Mock()
    clogged.write.side_effect = [None, WriteError("the disk is full")]
    chain = Pipeline(played(mix, 256), Framework(RATE, 2), [whole, clogged])
    chain.step()
    with pytest.raises(WriteError, match="disk is full"):
        chain.step()
    chain.abort()
    assert listing(tmp_path) == {}


@given(st.integers(0, 50), st.lists(st.integers(0, 20), max_size=12))
def test_alignment_drops_exactly_the_first_frames_however_they_come(latency, lengths):
    frames, output = np.arange(float(sum(lengths)))[:, None] + 1.0, KeptOutput(RATE)
    aligned = AlignedOutput(output, latency)
    assert (aligned.samplerate, aligned.channels) == (RATE, 1)
    for block in np.split(frames, np.cumsum(lengths)[:-1]) if lengths else []:
        aligned.write(block)
    aligned.close()
    assert np.array_equal(output.whole, frames[latency:])
    assert output.ended == ["closed"]


def test_a_sink_takes_the_vibration_and_clips_it_last():
    output, buffer = KeptOutput(RATE), MixBuffer(4, 2, 1)
    buffer.audio[:] = 0.25
    buffer.haptic[:, 0] = 0.75, 3.0, -8.0, np.nan
    HapticSink(output).write(buffer)
    assert output.blocks[0][:, 0].tolist() == [0.75, 1.0, -1.0, 0.0]
    assert np.isnan(buffer.haptic[3, 0]), "the buffer stays as it is"
    HapticSink(output, clip=False).write(buffer)
    assert output.blocks[1][:, 0].tolist() == [0.75, 3.0, -8.0, 0.0]


def test_after_standby_nothing_stale_is_left_and_a_sink_follows_the_format():
    output = KeptOutput(RATE)
    sink = HapticSink(output)
    for frames, channels in ((4, 2), (8, 2), (8, 1)):
        buffer = MixBuffer(frames, 2, channels)
        buffer.samples[:] = 0.5
        sink.write(buffer)
        assert output.blocks[-1].shape == (frames, channels)
    sink.standby()
    assert len(output.blocks) == 3, "standby sends nothing"
    assert not sink.sent.any()

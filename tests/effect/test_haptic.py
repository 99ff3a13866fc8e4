from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.haptic import HapticEffect
from audioflinger_hook.effect.haptic_parameters import DRAIN, HAPTIC_PARAMETERS, from_settings
from audioflinger_hook.effect.interface import EINVAL, ENODATA, ENOSYS, OK, Access, Command
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.transform import HapticTransform, TransformParameters
from tests.support.effects import FRAMES, RATE, FakeClock, config, noise
from tests.support.pipelines import music

SET, GET = Command.SET_PARAM, Command.GET_PARAM
SLOPE_MAX = 2 * np.pi * 220.0 / RATE
"""Largest step from frame to frame of a full-scale vibration at its highest frequency."""


def started(cfg=None, **values):
    cfg, chains = cfg or config(), EffectChains(FakeClock(), budget_share=float("inf"))
    chains.set_format(cfg.samplerate, cfg.channels, cfg.haptic_channels, cfg.frames)
    module = chains.add(HapticEffect(), 0)
    assert module.set_parameters(values) == OK
    module.enable()
    chains.end_of_cycle(0.0)
    assert module.state.name == "ACTIVE"
    return chains, module


def play(chains, sound, frames=FRAMES, haptic_channels=1):
    """The vibration of sound, which stays as it is; what haptic channels held must not come."""
    made = []
    for start in range(0, len(sound), frames):
        part = sound[start : start + frames]
        buffer = MixBuffer(len(part), sound.shape[1], haptic_channels)
        buffer.audio[:] = part
        buffer.haptic[:] = 0.77
        chains.process(0, buffer, start / RATE)
        assert buffer.audio.tobytes() == part.tobytes()
        made.append(buffer.haptic.copy())
        chains.end_of_cycle(start / RATE)
    return np.concatenate(made)


def transformed(sound, samplerate=RATE, **options):
    return HapticTransform(samplerate, sound.shape[1], **options).process(sound).astype(np.float32)


@pytest.mark.parametrize(
    ("channels", "per_channel", "played"),
    [
        *((3, True, [[0], [1], [2]]), (2, False, [[0], [0]]), (2, True, [[0], [1], [0], [1], [0]])),
        *((6, True, [range(6)]), (6, True, [[0, 2, 4], [1, 3, 5]])),
    ],
)
def test_voices_repeat_over_haptic_channels_and_few_play_their_means(channels, per_channel, played):
    sound = music(RATE // 4, channels)
    cfg = config(channels=channels, haptic_channels=len(played))
    chains, _ = started(cfg, per_channel=per_channel)
    vibration = play(chains, sound, haptic_channels=len(played))
    voices = HapticTransform(RATE, channels, per_channel=per_channel).process(sound)
    expected = np.stack([voices[:, own].mean(axis=1) for own in played], axis=1)
    # Rounding to float32, of a mean after it.
    several = len(played) < voices.shape[1]
    np.testing.assert_allclose(vibration, expected.astype(np.float32), several * 1e-6, atol=1e-9)


def test_a_stream_without_haptic_channels_is_refused_and_its_sound_passes():
    chains = EffectChains(FakeClock())
    chains.set_format(RATE, 2, 0, FRAMES)
    chains.add(HapticEffect(), 0).enable()
    chains.end_of_cycle(0.0)
    play(chains, music(FRAMES * 3), haptic_channels=0)
    assert chains.bypassed() == [
        "session 0, Haptic Cushion: refused 48000 Hz, 2 + 0 channels, 960 frames, write "
        "(status -22)"
    ]
    chains.set_format(RATE, 2, 1, FRAMES)
    chains.end_of_cycle(1.0)
    assert np.abs(play(chains, music(RATE // 4))).max() > 0.05


def test_with_accumulate_sound_and_vibration_are_added_and_the_vibration_kept_in_full_scale():
    alone, _ = started()
    added, module = started()
    for number, part in enumerate(np.split(music(FRAMES * 12), 12)):
        buffer, mix = MixBuffer(FRAMES, 2, 1), noise(seed=number)
        same = MixBuffer(FRAMES, 2, 1)
        buffer.audio[:] = same.audio[:] = part
        mix.haptic[:] = 0.98
        before = mix.audio.copy()
        added.process(0, buffer, 0.0, mix)
        alone.process(0, same, 0.0)
        np.testing.assert_array_equal(mix.audio, before + part)
        expected = np.clip(np.float32(0.98) + same.haptic, -1.0, 1.0)
        np.testing.assert_array_equal(mix.haptic, expected)
    assert module.access is Access.ACCUMULATE
    assert np.abs(same.haptic).max() > 0.1
    module.command(Command.DISABLE)
    added.end_of_cycle(0.0)
    mix.haptic[:] = 0.25
    added.process(0, buffer, 0.0, mix)
    assert np.all(mix.haptic == 0.25)


@pytest.mark.parametrize("idle_buffers", [0, 1, 5])
def test_after_the_buffer_of_disable_all_is_exact_silence_and_later_nothing_is_left(idle_buffers):
    chains, module = started()
    sound = music(FRAMES * 40)
    play(chains, sound[: FRAMES * 10])
    module.disable()
    last = play(chains, sound[FRAMES * 10 : FRAMES * 11])
    assert (module.state.name, np.abs(last).max() > 0.01) == ("STOPPED", True)
    if idle_buffers:
        # play fills the haptic channels with 0.77 before the effect.
        idle = play(chains, sound[FRAMES * 11 : FRAMES * (11 + idle_buffers)])
        assert (module.state.name, any(idle[:FRAMES].tobytes())) == ("IDLE", False)
    module.enable()
    play(chains, sound[:FRAMES])
    again = play(chains, sound[FRAMES * 20 :])
    assert again.tobytes() == transformed(sound[FRAMES * 20 :]).tobytes()


@pytest.mark.parametrize(("form", "gain_db"), [("live", 0.0), ("reference", 0.0), ("live", -6.0)])
def test_drain_gives_what_is_still_owed_and_begins_anew(form, gain_db):
    sound = music(FRAMES * 20)
    chains, module = started(form=form, gain_db=gain_db)
    vibration = play(chains, sound)
    status, owed = module.command(DRAIN)
    transform = HapticTransform(RATE, 2, form=form)
    whole = np.concatenate([transform.process(sound), transform.finish()])
    whole *= 10.0 ** (gain_db / 20.0)
    assert (status, owed.shape) == (OK, (transform.latency_frames, 1))
    np.testing.assert_allclose(np.concatenate([vibration, owed]), whole, rtol=1e-6, atol=1e-9)
    assert play(chains, sound).tobytes() == vibration.tobytes()


def test_drain_is_silence_while_disabled_and_nothing_without_a_stream():
    assert HapticEffect().command(DRAIN) == (ENODATA, None)
    chains, module = started(config(haptic_channels=2))
    play(chains, music(FRAMES * 10), haptic_channels=2)
    module.disable()
    chains.end_of_cycle(1.0)
    status, owed = module.command(DRAIN)
    assert (status, owed.shape) == (OK, (HapticTransform(RATE, 2).latency_frames, 2))
    assert not owed.any()


@pytest.mark.parametrize(("before", "after"), [(0.0, -20.0), (-20.0, 0.0), (-3.0, -60.0)])
def test_a_gain_acts_in_the_next_buffer_and_is_reached_in_it_without_a_step(before, after):
    sound = music(FRAMES * 20)
    chains, module = started(gain_db=before)
    start = play(chains, sound[: FRAMES * 10])
    assert module.command(SET, ("gain_db", after)) == (OK, None)
    made = np.concatenate([start, play(chains, sound[FRAMES * 10 :])])
    ramp = np.clip(np.arange(1, len(sound) + 1) / FRAMES - 10, 0.0, 1.0)[:, None]
    old, new = 10 ** (before / 20), 10 ** (after / 20)
    expected = HapticTransform(RATE, 2).process(sound) * (old + (new - old) * ramp)
    # Rounding to float32.
    np.testing.assert_allclose(made, expected, rtol=1e-6, atol=1e-9)


def test_mute_is_exact_silence_from_the_buffer_after_next_and_unmute_comes_back():
    sound = music(FRAMES * 40)
    chains, module = started()
    loud = play(chains, sound[: FRAMES * 10])
    module.command(SET, ("mute", True))
    fading = play(chains, sound[FRAMES * 10 : FRAMES * 11])
    silent = play(chains, sound[FRAMES * 11 : FRAMES * 20])
    module.command(SET, ("mute", False))
    back, full = play(chains, sound[FRAMES * 20 :]), transformed(sound)
    assert fading[-1] == 0.0
    assert not any(silent.tobytes())
    assert back[FRAMES:].tobytes() == full[FRAMES * 21 :].tobytes()
    whole = np.concatenate([loud, fading, silent, back])
    assert np.abs(np.diff(whole[:, 0])).max() <= np.abs(np.diff(full[:, 0])).max() + 1 / FRAMES


STATES = ["no stream", "IDLE", "STARTING", "ACTIVE", "STOPPING", "STOPPED", "RESTART"]
CALLS = {"STARTING": "e", "ACTIVE": "e_", "STOPPING": "e_d", "STOPPED": "e_d_", "RESTART": "e_d_e"}
"""What leads to a state: enable, disable, and the end of a cycle."""


def module_in(state):
    chains = EffectChains(FakeClock(), budget_share=float("inf"))
    module = chains.add(HapticEffect(), 0)
    if state != "no stream":
        chains.set_format(RATE, 2, 1, FRAMES)
    for call in CALLS.get(state, ""):
        {"e": module.enable, "d": module.disable, "_": lambda: chains.end_of_cycle(0.0)}[call]()
    assert module.state.name == state or state == "no stream"
    return module


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("profile", ["cinema", "music"])
def test_what_was_set_is_what_one_gets_in_every_state(state, profile):
    options: dict[str, Any] = {"form": "reference", "channels": "each", "gain_db": -6.5}
    values = from_settings(Settings(parameters=parameters_of(profile), **options))
    values |= {"mute": True, "clip": False}
    module = module_in(state)
    assert module.set_parameters(values) == OK
    for name, value in values.items():
        assert module.command(GET, name) == (OK, value)
    assert module.command(SET, ("gain_db", -1)) == (OK, None)
    assert module.command(GET, "gain_db") == (OK, -1)
    # And what is not possible changes nothing.
    assert module.command(SET, ("window_s", 5.0)) == (EINVAL, None)
    assert (module.command(GET, "window_s"), module.bypassed) == ((OK, values["window_s"]), "")


@pytest.mark.parametrize("state", STATES)
def test_values_that_contradict_each_other_are_refused_alone_and_possible_together(state):
    module = module_in(state)
    assert module.command(GET, "band_high_hz") == (OK, 12_000.0)
    assert module.command(SET, ("band_high_hz", 200.0)) == (OK, None)
    assert module.command(SET, ("band_low_hz", 150.0)) == (EINVAL, None)
    assert module.set_parameters({"band_low_hz": 150.0, "band_high_hz": 299.0}) == EINVAL
    assert module.command(Command.SET_PARAM_DEFERRED, ("gain_db", -9.0)) == (OK, None)
    assert module.command(GET, "gain_db") == (OK, 0.0), "it waits for its commit"
    assert module.command(Command.SET_PARAM_COMMIT) == (OK, None)
    assert module.command(GET, "gain_db") == (OK, -9.0)
    assert module.command(GET, "band_low_hz") == (OK, 50.0)
    assert module.set_parameters({"band_low_hz": 150.0, "band_high_hz": 300.0}) == OK
    assert module.command(GET, "band_low_hz") == (OK, 150.0)


def test_a_band_that_a_low_sample_rate_cannot_hold_is_refused():
    chains, module = started(config(1_000, frames=32))
    assert module.command(SET, ("band_low_hz", 1_000.0)) == (EINVAL, None)
    assert module.command(GET, "band_low_hz") == (OK, 50.0)
    chains.set_format(RATE, 2, 1, FRAMES)
    assert module.command(SET, ("band_low_hz", 1_000.0)) == (OK, None)
    chains.set_format(1_000, 2, 1, 32)
    assert "refused 1000 Hz" in module.bypassed
    assert module.faults == 0


@pytest.mark.parametrize(
    "change", [{"window_s": 0.1}, {"threshold_hz": 5.0}, {"form": "reference"}, {"mapping": "jnd"}]
)
def test_a_change_of_the_transform_fades_out_over_a_buffer_and_begins_anew(change):
    sound = music(FRAMES * 60)
    chains, module = started()
    start = play(chains, sound[: FRAMES * 20])
    assert module.set_parameters(change) == OK
    fading = play(chains, sound[FRAMES * 20 : FRAMES * 21])
    end, old = play(chains, sound[FRAMES * 21 :]), transformed(sound)
    ramp = 1.0 - np.arange(1, FRAMES + 1)[:, None] / FRAMES
    np.testing.assert_allclose(fading, old[FRAMES * 20 : FRAMES * 21] * ramp, rtol=1e-5, atol=1e-9)
    form = change.pop("form", "live")
    fresh = transformed(sound[FRAMES * 21 :], parameters=TransformParameters(**change), form=form)
    assert end.tobytes() == fresh.tobytes()
    if form == "live":
        whole = np.concatenate([start, fading, end])
        assert np.abs(np.diff(whole[:, 0])).max() <= SLOPE_MAX + 1 / FRAMES


def test_counters_can_be_read_with_a_stream_only_and_never_set():
    effect, (chains, module) = HapticEffect(), started()
    for name in ("latency_frames", "limited_samples", "replaced_samples"):
        assert effect.command(GET, name) == (ENODATA, None)
        assert module.command(SET, (name, 3)) == (EINVAL, None)
    for window_s in (0.04643, 0.08):  # of the newest transform, at once
        module.command(SET, ("window_s", window_s))
        parameters = TransformParameters(window_s=window_s)
        newest = (OK, HapticTransform(RATE, 2, parameters).latency_frames)
        assert module.command(GET, "latency_frames") == newest
        play(chains, music(FRAMES))
        assert module.command(GET, "latency_frames") == newest


def test_counters_go_on_over_changes_resets_and_other_rates():
    chains, module = started()
    broken = music(FRAMES * 20, level=8.0)  # with one sample that is not a number
    limited, replaced = [0], []
    for change in (
        *(lambda: None, lambda: module.command(SET, ("window_s", 0.05))),
        *(lambda: module.command(Command.RESET), lambda: chains.set_format(44_100, 2, 1, FRAMES)),
    ):
        change()
        play(chains, broken)
        limited.append(module.command(GET, "limited_samples")[1])
        replaced.append(module.command(GET, "replaced_samples")[1])
    assert replaced == [1, 2, 3, 4]
    assert all(before < after for before, after in pairwise(limited))


def test_a_new_buffer_size_does_not_disturb_the_vibration_and_a_new_rate_begins_anew():
    sound = music(FRAMES * 20)
    chains, module = started()
    start = play(chains, sound[: FRAMES * 10])
    chains.set_format(RATE, 2, 1, 256)
    end = play(chains, sound[FRAMES * 10 :], 256)
    assert np.concatenate([start, end]).tobytes() == transformed(sound).tobytes()
    assert module.set_parameters({"gain_db": -60.0, "partials_max": 3}) == OK
    assert module.set_parameters({"gain_db": 0.0}) == OK
    chains.set_format(44_100, 2, 1, 256)
    again, three = play(chains, sound, 256), TransformParameters(partials_max=3)
    assert again.tobytes() == transformed(sound, 44_100, parameters=three).tobytes()


def test_reset_begins_anew_and_neither_queries_nor_a_value_that_is_set_already_do():
    sound = music(FRAMES * 20)
    chains, module = started()
    play(chains, sound[: FRAMES * 7])
    assert module.command(Command.RESET) == (OK, None)
    start = play(chains, sound[: FRAMES * 10])
    assert module.command(SET, ("window_s", 0.04643)) == (OK, None)
    for parameter in HAPTIC_PARAMETERS:
        module.command(GET, parameter.name)
    chains.dump()
    end = play(chains, sound[FRAMES * 10 :])
    assert np.concatenate([start, end]).tobytes() == transformed(sound).tobytes()


def test_all_parameters_but_two_come_from_the_settings_of_a_user():
    names = {parameter.name for parameter in HAPTIC_PARAMETERS if not parameter.read_only}
    assert names - from_settings(Settings()).keys() == {"mute", "clip"}


def test_driven_without_a_framework_it_keeps_its_order():
    effect, buffer, other = HapticEffect(), noise(), MixBuffer(FRAMES, 2, 1)
    assert effect.process(buffer, buffer) == EINVAL
    refused = ((48_000, 2), config(999), config(768_001), config(channels=65))
    for code, data, expected in (
        *((Command.ENABLE, None, (EINVAL, None)), (Command.RESET, None, (OK, None))),
        (Command.GET_CONFIG, None, (ENODATA, None)),
        *((Command.SET_CONFIG, cfg, (EINVAL, None)) for cfg in refused),
        (Command.OFFLOAD, (False, 1), (ENOSYS, None)),
        *((Command.SET_CONFIG, config(), (OK, None)), (Command.GET_CONFIG, None, (OK, config()))),
        (Command.DISABLE, None, (OK, None)),
    ):
        assert effect.command(code, data) == expected
    assert effect.process(buffer, buffer) == ENODATA
    assert not buffer.haptic.any()
    for _ in range(2):
        assert effect.command(Command.ENABLE) == (OK, None)
    assert (effect.process(buffer, other), other.audio.tobytes()) == (OK, buffer.audio.tobytes())


def test_what_full_scale_cuts_is_counted_and_a_file_may_have_it_uncut():
    sound = music(FRAMES * 20, level=20.0)
    chains, module = started(form="reference")
    assert np.abs(play(chains, sound)).max() == 1.0
    assert module.command(GET, "limited_samples")[1] > 100
    chains, module = started(form="reference", clip=False)
    assert np.abs(play(chains, sound)).max() > 2.0
    assert module.command(GET, "limited_samples") == (OK, 0)

"""The haptic effect in its chain: what it writes and leaves, and defects it must not have."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.haptic import HapticEffect
from audioflinger_hook.effect.haptic_parameters import (
    DRAIN,
    HAPTIC_CUSHION,
    HAPTIC_PARAMETERS,
    from_settings,
)
from audioflinger_hook.effect.interface import EINVAL, ENODATA, ENOSYS, OK, Access, Command
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.transform import Form, HapticTransform, TransformParameters
from tests.support.effects import CYCLE_S, FRAMES, RATE, FakeClock, config, noise, running
from tests.support.parameters import CHOICES, LIMITS

SET, GET = Command.SET_PARAM, Command.GET_PARAM
SLOPE_MAX = 2 * np.pi * 220.0 / RATE
"""Largest step from frame to frame of a full-scale vibration at its highest frequency."""


def tones(frames, channels=2, samplerate=RATE, level=0.5):
    """Two steady tones, the same in each channel but for their level."""
    seconds = np.arange(frames)[:, None] / samplerate
    sound = np.sin(2 * np.pi * 440.0 * seconds) + np.sin(2 * np.pi * 1_500.0 * seconds)
    levels = level / 2 * np.linspace(1.0, 0.5, channels)
    return (sound * levels).astype(np.float32)


def rough(frames, channels=2, seed=0):
    """Bursts of noise and tones between silences, with much for the tracker to do."""
    rng = np.random.default_rng(seed)
    sound = 0.3 * rng.standard_normal((frames, channels))
    sound *= np.sin(2 * np.pi * 3.0 * np.arange(frames)[:, None] / RATE) > 0.0
    return (sound + tones(frames, channels)).astype(np.float32)


def started(cfg=None, **values):
    """Chains with one running haptic effect, and its module."""
    cfg = cfg or config()
    chains = EffectChains(FakeClock(), budget_share=float("inf"))
    chains.set_format(cfg.samplerate, cfg.channels, cfg.haptic_channels, cfg.frames)
    module = chains.add(HapticEffect(), 0)
    assert module.set_parameters(values) == OK
    module.enable()
    chains.end_of_cycle(0.0)
    assert module.state.name == "ACTIVE"
    return chains, module


def play(chains, sound, frames=FRAMES, haptic_channels=1, end=True):
    """Send sound through session 0 and return the vibration, all buffers joined.

    Before the effect the haptic channels hold what must not come through, and the sound must
    come out as it went in.
    """
    made = []
    for start in range(0, len(sound), frames):
        part = sound[start : start + frames]
        buffer = MixBuffer(len(part), sound.shape[1], haptic_channels)
        buffer.audio[:] = part
        buffer.haptic[:] = 0.77
        chains.process(0, buffer, start / RATE)
        assert buffer.audio.tobytes() == part.tobytes()
        made.append(buffer.haptic.copy())
        if end:
            chains.end_of_cycle(start / RATE)
    return np.concatenate(made)


def transformed(sound, samplerate=RATE, **options):
    transform = HapticTransform(samplerate, sound.shape[1], **options)
    return transform.process(sound).astype(np.float32)


# What it writes.


@pytest.mark.parametrize(
    ("channels", "per_channel", "voices"),
    [(3, True, [0, 1, 2]), (2, False, [0, 0]), (2, True, [0, 1, 0, 1, 0])],
)
def test_voices_repeat_over_the_haptic_channels(channels, per_channel, voices):
    sound = rough(RATE // 4, channels)
    cfg = config(channels=channels, haptic_channels=len(voices))
    chains, _ = started(cfg, per_channel=per_channel)
    vibration = play(chains, sound, haptic_channels=len(voices))
    expected = transformed(sound, per_channel=per_channel)
    np.testing.assert_array_equal(vibration, expected[:, voices])


@pytest.mark.parametrize("haptic_channels", [1, 2])
def test_where_there_are_fewer_haptic_channels_each_plays_the_mean_of_its_voices(haptic_channels):
    sound = rough(RATE // 4, 6)
    chains, _ = started(config(channels=6, haptic_channels=haptic_channels), per_channel=True)
    vibration = play(chains, sound, haptic_channels=haptic_channels)
    voices = HapticTransform(RATE, 6, per_channel=True).process(sound)
    for place in range(haptic_channels):
        expected = voices[:, place::haptic_channels].mean(axis=1)
        # Rounding to float32.
        np.testing.assert_allclose(vibration[:, place], expected, rtol=1e-6, atol=1e-9)


def test_a_stream_without_haptic_channels_is_refused_and_its_sound_passes():
    chains = EffectChains(FakeClock())
    chains.set_format(RATE, 2, 0, FRAMES)
    module = chains.add(HapticEffect(), 0)
    module.enable()
    chains.end_of_cycle(0.0)
    play(chains, rough(FRAMES * 3), haptic_channels=0)
    assert chains.bypassed() == [
        "session 0, Haptic Cushion: refused 48000 Hz, 2 + 0 channels, 960 frames, write "
        "(status -22)"
    ]
    chains.set_format(RATE, 2, 1, FRAMES)
    chains.end_of_cycle(1.0)
    assert np.abs(play(chains, rough(RATE // 4))).max() > 0.05


@pytest.mark.parametrize("cfg", [config(999), config(768_001), config(channels=65)])
def test_a_stream_that_the_transform_cannot_take_is_refused(cfg):
    assert HapticEffect().command(Command.SET_CONFIG, cfg) == (EINVAL, None)


def test_with_accumulate_sound_and_vibration_are_added_and_the_vibration_kept_in_full_scale():
    alone, _ = started()
    added, module = started()
    for number, part in enumerate(np.split(rough(FRAMES * 12), 12)):
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


def test_it_asks_to_stand_last_on_a_session_of_its_own_type():
    generator_type = "1411e6d6-aecd-4021-a1cf-a6aceb0d71e5"  # Android's HapticGenerator
    assert str(HAPTIC_CUSHION.type_uuid) != generator_type
    assert HAPTIC_CUSHION.type_uuid != HAPTIC_CUSHION.uuid


# The sound, and silence.


def test_sound_passes_bit_for_bit_whatever_it_is():
    sound = rough(FRAMES * 8)
    sound[100:108, 0] = [np.nan, np.inf, -np.inf, -0.0, 1e-44, 3e38, 5.0, -5.0]
    chains, module = started()
    vibration = play(chains, sound)
    assert np.all(np.isfinite(vibration))
    assert module.command(GET, "replaced_samples") == (OK, 4)
    assert module.faults == 0


def test_the_first_buffer_after_disable_was_delivered_is_exact_silence():
    chains, module = started()
    sound = rough(FRAMES * 40)
    play(chains, sound[: FRAMES * 10])
    module.disable()
    last = play(chains, sound[FRAMES * 10 : FRAMES * 11])
    assert module.state.name == "STOPPED"
    assert np.abs(last).max() > 0.01
    # play fills the haptic channels with 0.77 before the effect.
    silent = play(chains, sound[FRAMES * 11 : FRAMES * 12])
    assert not silent.any()
    assert not np.signbit(silent).any()
    assert module.state.name == "IDLE"


@pytest.mark.parametrize("idle_buffers", [0, 1, 5])
def test_nothing_of_the_past_is_left_when_it_is_enabled_again(idle_buffers):
    chains, module = started()
    sound = rough(FRAMES * 40)
    play(chains, sound[: FRAMES * 10])
    module.disable()
    play(chains, sound[: FRAMES * (1 + idle_buffers)])
    module.enable()
    play(chains, sound[:FRAMES])
    again = play(chains, sound[FRAMES * 20 :])
    assert again.tobytes() == transformed(sound[FRAMES * 20 :]).tobytes()


def test_drain_gives_what_is_still_owed_and_begins_anew():
    sound = rough(FRAMES * 20)
    for form, gain_db in (("live", 0.0), ("reference", 0.0), ("live", -6.0)):
        chains, module = started(form=form, gain_db=gain_db)
        vibration = play(chains, sound)
        status, owed = module.command(DRAIN)
        transform = HapticTransform(RATE, 2, form=cast(Form, form))
        whole = np.concatenate([transform.process(sound), transform.finish()])
        whole *= 10.0 ** (gain_db / 20.0)
        assert (status, owed.shape) == (OK, (transform.latency_frames, 1))
        np.testing.assert_allclose(np.concatenate([vibration, owed]), whole, rtol=1e-6, atol=1e-9)
        again = play(chains, sound)
        assert again.tobytes() == vibration.tobytes()


def test_drain_is_silence_while_disabled_and_nothing_without_a_stream():
    effect = HapticEffect()
    assert effect.command(DRAIN) == (ENODATA, None)
    effect.command(Command.SET_CONFIG, config(haptic_channels=2))
    effect.command(Command.ENABLE)
    buffer = noise(haptic_channels=2, level=0.3)
    for _ in range(10):
        effect.process(buffer, buffer)
    effect.command(Command.DISABLE)
    status, owed = effect.command(DRAIN)
    assert isinstance(owed, np.ndarray)
    assert (status, owed.shape) == (OK, (HapticTransform(RATE, 2).latency_frames, 2))
    assert not owed.any()


# Level.


@pytest.mark.parametrize(("before", "after"), [(0.0, -20.0), (-20.0, 0.0), (-3.0, -60.0)])
def test_a_gain_acts_in_the_next_buffer_and_is_reached_in_it_without_a_step(before, after):
    sound = rough(FRAMES * 20)
    chains, module = started(gain_db=before)
    start = play(chains, sound[: FRAMES * 10])
    assert module.command(SET, ("gain_db", after)) == (OK, None)
    end = play(chains, sound[FRAMES * 10 :])
    full = HapticTransform(RATE, 2).process(sound)
    old, new = 10 ** (before / 20), 10 ** (after / 20)
    levels = np.full((len(sound), 1), new)
    levels[: FRAMES * 10] = old
    ramp = slice(FRAMES * 10, FRAMES * 11)
    levels[ramp, 0] = old + (new - old) * np.arange(1, FRAMES + 1) / FRAMES
    # Rounding to float32.
    np.testing.assert_allclose(np.concatenate([start, end]), full * levels, rtol=1e-6, atol=1e-9)


def test_mute_is_exact_silence_from_the_buffer_after_next_and_unmute_comes_back():
    sound = rough(FRAMES * 40)
    chains, module = started()
    loud = play(chains, sound[: FRAMES * 10])
    module.command(SET, ("mute", True))
    fading = play(chains, sound[FRAMES * 10 : FRAMES * 11])
    silent = play(chains, sound[FRAMES * 11 : FRAMES * 20])
    module.command(SET, ("mute", False))
    back = play(chains, sound[FRAMES * 20 :])
    full = transformed(sound)
    assert fading[-1] == 0.0
    assert not silent.any()
    assert not np.signbit(silent).any()
    assert back[FRAMES:].tobytes() == full[FRAMES * 21 :].tobytes()
    whole = np.concatenate([loud, fading, silent, back])
    assert np.abs(np.diff(whole[:, 0])).max() <= np.abs(np.diff(full[:, 0])).max() + 1 / FRAMES


# Parameters.

STATES = ["no stream", "IDLE", "STARTING", "ACTIVE", "STOPPING", "STOPPED", "RESTART"]


def module_in(state):
    chains, module = running(HapticEffect(), budget_share=float("inf"))
    if state in ("no stream", "IDLE", "STARTING"):
        chains = EffectChains(FakeClock())
        module = chains.add(HapticEffect(), 0)
        if state != "no stream":
            chains.set_format(RATE, 2, 1, FRAMES)
        if state == "STARTING":
            module.enable()
    elif state != "ACTIVE":
        module.disable()
        if state != "STOPPING":
            chains.end_of_cycle(0.0)
        if state == "RESTART":
            module.enable()
    assert module.state.name == state or state == "no stream"
    return module


@st.composite
def possible_values(draw):
    values = {
        name: draw(
            st.integers(int(limits.low), int(limits.high))
            if name == "partials_max"
            else st.floats(limits.low, limits.high)
        )
        for name, limits in LIMITS.items()
    }
    low = values["band_low_hz"]
    values["band_high_hz"] = draw(st.floats(max(200.0, 2 * low), 20_000.0))
    bottom = max(60.0, np.nextafter(2 / values["window_s"], np.inf))
    values["vibration_top_hz"] = draw(st.floats(float(bottom), 400.0))
    for name, choice in CHOICES.items():
        values[name] = draw(st.sampled_from(choice.words))
    values["form"] = draw(st.sampled_from(["live", "reference"]))
    values["gain_db"] = draw(st.floats(-60.0, 0.0))
    for switch in ("mute", "per_channel", "clip"):
        values[switch] = draw(st.booleans())
    return values


@pytest.mark.parametrize("state", STATES)
@hypothesis_settings(max_examples=4)
@given(values=possible_values())
def test_what_was_set_is_what_one_gets_in_every_state(state, values):
    module = module_in(state)
    assert module.set_parameters(values) == OK
    for name, value in values.items():
        assert module.command(GET, name) == (OK, value)
    assert module.command(SET, ("gain_db", -1)) == (OK, None)
    assert module.command(GET, "gain_db") == (OK, -1)
    # And what is not possible changes nothing.
    assert module.command(SET, ("window_s", 5.0)) == (EINVAL, None)
    assert module.command(GET, "window_s") == (OK, values["window_s"])
    assert module.bypassed == ""


@pytest.mark.parametrize("state", STATES)
def test_values_that_contradict_each_other_are_refused_alone_and_possible_together(state):
    module = module_in(state)
    before = module.command(GET, "band_high_hz")
    assert module.command(SET, ("band_high_hz", 200.0)) == (OK, None)
    assert module.command(SET, ("band_low_hz", 150.0)) == (EINVAL, None)
    assert module.set_parameters({"band_low_hz": 150.0, "band_high_hz": 299.0}) == EINVAL
    assert module.command(GET, "band_low_hz") == (OK, 50.0)
    deferred = Command.SET_PARAM_DEFERRED, ("gain_db", -9.0)
    assert module.command(*deferred) == (OK, None)
    assert module.command(GET, "gain_db") == (OK, 0.0), "it waits for its commit"
    assert module.command(Command.SET_PARAM_COMMIT) == (OK, None)
    assert module.command(GET, "gain_db") == (OK, -9.0)
    assert module.command(GET, "band_low_hz") == (OK, 50.0)
    assert module.set_parameters({"band_low_hz": 150.0, "band_high_hz": 300.0}) == OK
    assert module.command(GET, "band_low_hz") == (OK, 150.0)
    assert before == (OK, 12_000.0)


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
    "change",
    [{"window_s": 0.1}, {"threshold_hz": 5.0}, {"form": "reference"}, {"mapping": "jnd"}],
)
def test_a_change_of_the_transform_fades_out_over_a_buffer_and_begins_anew(change):
    sound = rough(FRAMES * 60)
    chains, module = started()
    start = play(chains, sound[: FRAMES * 20])
    assert module.set_parameters(change) == OK
    fading = play(chains, sound[FRAMES * 20 : FRAMES * 21])
    end = play(chains, sound[FRAMES * 21 :])
    old = transformed(sound)
    ramp = 1.0 - np.arange(1, FRAMES + 1)[:, None] / FRAMES
    np.testing.assert_allclose(fading, old[FRAMES * 20 : FRAMES * 21] * ramp, rtol=1e-5, atol=1e-9)
    form = change.pop("form", "live")
    parameters = TransformParameters(**change)
    fresh = transformed(sound[FRAMES * 21 :], parameters=parameters, form=form)
    assert end.tobytes() == fresh.tobytes()
    if form == "live":
        whole = np.concatenate([start, fading, end])
        assert np.abs(np.diff(whole[:, 0])).max() <= SLOPE_MAX + 1 / FRAMES


def test_latency_is_that_of_the_newest_transform():
    chains, module = started()
    assert module.command(GET, "latency_frames") == (OK, HapticTransform(RATE).latency_frames)
    module.command(SET, ("window_s", 0.08))
    longer = HapticTransform(RATE, parameters=TransformParameters(window_s=0.08)).latency_frames
    assert module.command(GET, "latency_frames") == (OK, longer)
    play(chains, rough(FRAMES))
    assert module.command(GET, "latency_frames") == (OK, longer)


def test_counters_can_be_read_with_a_stream_only_and_never_set():
    effect, (_, module) = HapticEffect(), started()
    for name in ("latency_frames", "limited_samples", "replaced_samples"):
        assert effect.command(GET, name) == (ENODATA, None)
        assert module.command(SET, (name, 3)) == (EINVAL, None)
    effect.command(Command.SET_CONFIG, config())
    latency_frames = HapticTransform(RATE, 2).latency_frames
    assert effect.command(GET, "latency_frames") == (OK, latency_frames)


def test_counters_go_on_over_changes_resets_and_other_rates():
    chains, module = started()
    broken = tones(FRAMES * 20, level=8.0)
    broken[5, 0] = np.nan
    counts = []
    for step in ("start", "window_s", "reset", "rate"):
        if step == "window_s":
            module.command(SET, ("window_s", 0.05))
        elif step == "reset":
            module.command(Command.RESET)
        elif step == "rate":
            chains.set_format(44_100, 2, 1, FRAMES)
        play(chains, broken)
        counts.append(
            [module.command(GET, name)[1] for name in ("limited_samples", "replaced_samples")]
        )
    assert [replaced for _, replaced in counts] == [1, 2, 3, 4]
    limited = [limited for limited, _ in counts]
    assert limited[0] > 0
    assert all(before < after for before, after in pairwise(limited))


def test_a_new_buffer_size_does_not_disturb_the_vibration_and_a_new_rate_begins_anew():
    sound = rough(FRAMES * 20)
    chains, module = started()
    start = play(chains, sound[: FRAMES * 10])
    chains.set_format(RATE, 2, 1, 256)
    end = play(chains, sound[FRAMES * 10 :], 256)
    assert np.concatenate([start, end]).tobytes() == transformed(sound).tobytes()
    assert module.set_parameters({"gain_db": -60.0, "partials_max": 3}) == OK
    assert module.set_parameters({"gain_db": 0.0}) == OK
    chains.set_format(44_100, 2, 1, 256)
    again = play(chains, sound, 256)
    three = TransformParameters(partials_max=3)
    assert again.tobytes() == transformed(sound, 44_100, parameters=three).tobytes()


def test_reset_while_active_begins_anew_and_a_value_that_is_set_already_restarts_nothing():
    sound = rough(FRAMES * 20)
    chains, module = started()
    play(chains, sound[: FRAMES * 7])
    assert module.command(Command.RESET) == (OK, None)
    start = play(chains, sound[: FRAMES * 10])
    assert module.command(SET, ("window_s", 0.04643)) == (OK, None)
    end = play(chains, sound[FRAMES * 10 :])
    assert np.concatenate([start, end]).tobytes() == transformed(sound).tobytes()


def test_settings_of_a_user_become_parameters():
    values = from_settings(Settings(form="reference", channels="each", gain_db=-6.0))
    _, module = started()
    assert module.set_parameters(values) == OK
    assert module.command(GET, "form") == (OK, "reference")
    assert module.command(GET, "per_channel") == (OK, True)
    names = {parameter.name for parameter in HAPTIC_PARAMETERS if not parameter.read_only}
    assert names - values.keys() == {"mute", "clip"}


def test_driven_without_a_framework_it_keeps_its_order():
    effect = HapticEffect()
    buffer = noise()
    assert effect.process(buffer, buffer) == EINVAL
    assert effect.command(Command.ENABLE) == (EINVAL, None)
    assert effect.command(Command.RESET) == (OK, None)
    assert effect.command(Command.GET_CONFIG) == (ENODATA, None)
    assert effect.command(Command.SET_CONFIG, (48_000, 2)) == (EINVAL, None)
    assert effect.command(Command.OFFLOAD, (False, 1)) == (ENOSYS, None)
    assert effect.command(Command.SET_CONFIG, config()) == (OK, None)
    assert effect.command(Command.GET_CONFIG) == (OK, config())
    assert effect.command(Command.DISABLE) == (OK, None)
    assert effect.process(buffer, buffer) == ENODATA
    assert not buffer.haptic.any()
    for _ in range(2):
        assert effect.command(Command.ENABLE) == (OK, None)
    other = MixBuffer(FRAMES, 2, 1)
    assert effect.process(buffer, other) == OK
    assert other.audio.tobytes() == buffer.audio.tobytes()


# Instances.


def test_many_instances_in_parallel_each_give_their_own_vibration():
    sounds = [rough(FRAMES * 10, seed=seed) for seed in range(12)]

    def work(sound):
        chains, _ = started()
        return play(chains, sound).tobytes()

    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(work, sounds))
    assert made == [transformed(sound).tobytes() for sound in sounds]
    assert len(set(made)) == 12


# Known defects of Android's effect.


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("haptic_channels", [1, 2])
def test_the_right_channel_is_not_ignored(per_channel, haptic_channels):
    peaks = []
    for side in (0, 1):
        sound = np.zeros((FRAMES * 20, 2), np.float32)
        sound[:, side] = tones(FRAMES * 20, 1)[:, 0]
        chains, _ = started(config(haptic_channels=haptic_channels), per_channel=per_channel)
        peaks.append(np.abs(play(chains, sound, haptic_channels=haptic_channels)).max())
    assert peaks[0] == peaks[1] > 0.05


def test_what_full_scale_cuts_is_counted_and_a_file_may_have_it_uncut():
    sound = tones(FRAMES * 20, level=20.0)
    chains, _ = started()
    assert np.abs(play(chains, sound)).max() <= 1.0
    chains, module = started(form="reference")
    assert np.abs(play(chains, sound)).max() == 1.0
    assert module.command(GET, "limited_samples")[1] > 100
    chains, module = started(form="reference", clip=False)
    uncut = play(chains, sound)
    assert np.abs(uncut).max() > 2.0
    assert uncut.tobytes() == transformed(sound, form="reference").tobytes()
    assert module.command(GET, "limited_samples") == (OK, 0)


@pytest.mark.parametrize("frames", [1, 7, 48, 192, 256, 741, 4_096])
def test_the_output_does_not_depend_on_the_block_size(frames):
    sound = rough(FRAMES * 5 if frames == 1 else FRAMES * 25)
    chains, _ = started(config(frames=frames, haptic_channels=2), per_channel=True, gain_db=-3.0)
    vibration = play(chains, sound, frames, 2)
    whole, _ = started(config(frames=len(sound), haptic_channels=2), per_channel=True, gain_db=-3.0)
    assert vibration.tobytes() == play(whole, sound, len(sound), 2).tobytes()


def test_time_and_queries_do_not_change_the_vibration():
    sound = rough(FRAMES * 20)
    chains, module = started()
    made = []
    for cycle, part in enumerate(np.split(sound, 20)):
        made.append(play(chains, part, end=False))
        chains.end_of_cycle(cycle * 1_000.0)
        chains.dump()
        for parameter in HAPTIC_PARAMETERS:
            module.command(GET, parameter.name)
    assert np.concatenate(made).tobytes() == transformed(sound).tobytes()
    assert CYCLE_S == 0.02

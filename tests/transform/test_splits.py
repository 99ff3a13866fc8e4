import functools
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.scenes.speech import speech
from audioflinger_hook.transform import TransformParameters
from tests.oracle import vibration_of
from tests.support import signals

ODD_RATE = 37_123
"""A prime: no window, hop or spectrum comes out even."""

SAMPLERATES = (44_100, 48_000, ODD_RATE)
BLOCKS_MAX = 8_000
WAYS: dict[str, dict[str, Any]] = {
    "live": {},
    "reference": {"form": "reference"},
    "live, each channel": {"per_channel": True},
    "reference, each channel": {"form": "reference", "per_channel": True},
    "following": {
        "parameters": TransformParameters(loudness_db=30.0, amplitude_mapping="energy"),
        "per_channel": True,
    },
    "without speech": {"parameters": TransformParameters(speech_suppression_db=18.0)},
    "merging": {"parameters": parameters_of("cinema"), "per_channel": True},
}

every_way = pytest.mark.parametrize("way", WAYS)
every_form = pytest.mark.parametrize("form", signals.FORMS)


@functools.cache
def busy(samplerate, seconds=1.0):
    """Return sound that wakes every branch: silences, births and deaths, weak and strong peaks, and
    low noise around the image's threshold, where neighbouring hops differ in holding a peak."""
    return signals.joined(
        signals.silence(0.1, samplerate),
        signals.tone(300, 0.1, samplerate, 0.7),
        # Long enough for the ringing to end (0.4 s) and the form to fall asleep.
        signals.silence(0.62, samplerate),
        signals.low_noise(0.6, samplerate, 0.04, seed=1),
        signals.white_noise(0.2, samplerate, 0.4, seed=2),
        signals.burst(1_000, 0.05, 0.35, samplerate, 0.9),
        signals.one_sample(0.1, samplerate, 0.05),
        signals.low_noise(0.3, samplerate, 0.02, seed=3),
        signals.chirp(60, 11_000, 0.3, samplerate),
        signals.square(90, 0.1, samplerate),
        speech(samplerate, np.random.default_rng(1), 0.42)[: 2 * samplerate].mean(axis=1),
    )[: round(seconds * samplerate)]


def stereo(samplerate, seconds=1.0):
    """Return two channels that are opposite for a sixth of the time and else differ."""
    left = busy(samplerate, seconds)
    right = 0.7 * left[::-1]
    right[left.size // 3 : left.size // 2] = -left[left.size // 3 : left.size // 2]
    return signals.columns(left, right)


@functools.cache
def whole(way, samplerate, seconds):
    return signals.played(stereo(samplerate, seconds), samplerate, **WAYS[way])


def every(frames, total):
    return [frames] * (total // frames)


@pytest.mark.sweep
@every_way
@pytest.mark.parametrize(
    ("frames", "samplerate"),
    [
        *product((240,), SAMPLERATES),
        # Each of the others at two samplerates, so that both meet in every pair of them.
        *product((1, 7, 960), (44_100, ODD_RATE)),
        *((256, 48_000), (256, ODD_RATE), (4_096, 44_100), (4_096, 48_000)),
    ],
)
def test_blocks_of_any_one_size_give_the_bytes_of_one_block(way, samplerate, frames):
    seconds = 1.6 if frames == 1 else 4.8
    sound = stereo(samplerate, seconds)
    cut = signals.in_blocks(sound, every(frames, len(sound)), samplerate, **WAYS[way])
    assert whole(way, samplerate, seconds).any()
    assert signals.identical(cut, whole(way, samplerate, seconds))


@every_way
@given(seed=st.integers(0, 2**32 - 1), typical=st.sampled_from([3, 40, 700, 5_000, 60_000]))
@settings(max_examples=6)
def test_random_splits_give_the_bytes_of_one_block(way, seed, typical):
    sound, rng = stereo(16_000, 4.8), np.random.default_rng(seed)
    begin = rng.integers(max(1, len(sound) - BLOCKS_MAX * typical))  # so that small blocks fit in
    blocks = rng.exponential(typical, min(1 + len(sound) // typical, BLOCKS_MAX)).astype(int)
    cut = signals.in_blocks(sound, [begin, *blocks], 16_000, **WAYS[way])
    assert signals.identical(cut, whole(way, 16_000, 4.8))


@pytest.mark.sweep
@every_form
def test_asleep_and_awake_again_gives_the_same_bytes_in_any_blocks(form):
    samplerate = 44_100
    nap = signals.silence(1.3, samplerate)
    # High, with soft ends: the last windows are heard only for what hops before them held.
    chirrup = signals.tone(5_000, 0.1, samplerate, 0.5) * np.hanning(round(0.1 * samplerate))
    awake = (signals.tone(200, 0.2, samplerate), signals.white_noise(0.01, samplerate), chirrup)
    rumble = signals.low_noise(0.2, samplerate, 0.03)
    sound = signals.joined(nap, *(signals.joined(one, nap) for one in (*awake, rumble)))
    expected = signals.played(sound, samplerate, form=form)
    for frames in (97, 689, 690, 691, 20_000):
        cut = signals.in_blocks(sound, every(frames, sound.size), samplerate, form=form)
        assert signals.identical(cut, expected), f"blocks of {frames}"


@every_way
def test_what_follows_finish_or_reset_is_a_new_stream(way):
    sound = stereo(16_000, 4.8)
    transform = signals.made(sound, 16_000, **WAYS[way])
    for end in (transform.finish, transform.reset):
        assert signals.identical(
            np.concatenate((transform.process(sound), transform.finish())), whole(way, 16_000, 4.8)
        )
        transform.process(sound[: len(sound) // 2])
        end()
    assert signals.identical(transform.process(sound), whole(way, 16_000, 4.8)[: len(sound)])


@every_way
def test_the_layout_of_a_block_in_memory_changes_nothing(way):
    sound = stereo(48_000, 1.2).astype(np.float32)
    expected = signals.played(sound, 48_000, **WAYS[way])
    wide = np.zeros((len(sound), 6), np.float32)
    wide[:, [1, 4]] = sound
    # float64 holds every float32, so the type alone makes no difference.
    exact, turned = sound.astype(np.float64), sound[::-1].copy()[::-1]
    mirrored = sound[:, ::-1].copy()[:, ::-1]
    for view in (np.asfortranarray(sound), wide[:, 1::3], turned, mirrored, exact):
        assert signals.identical(signals.played(view, 48_000, **WAYS[way]), expected)


@every_form
def test_a_block_is_not_written_to_and_may_be_reused_by_its_owner(form):
    sound = stereo(48_000, 1.0)
    expected = signals.played(sound, 48_000, form=form)
    transform, buffer = signals.made(sound, 48_000, form=form), np.empty((480, 2))
    parts = []
    for first in range(0, len(sound), 480):
        buffer[:] = sound[first : first + 480]
        played_now = transform.process(buffer)
        parts.append(played_now.copy())
        np.testing.assert_array_equal(buffer, sound[first : first + 480])
        # Neither what the caller does to its own block nor to the result comes back later.
        buffer[:] = np.nan
        played_now[:] = np.nan
    parts.append(transform.finish())
    assert signals.identical(np.concatenate(parts), expected)


RATE = 48_000
HOP = 864


def bursts(seconds=1.0, seed=0):
    """Return noise bursts over a tone: envelopes that depend much on where hops begin."""
    at = signals.times(seconds, RATE)
    noise = 0.2 * np.random.default_rng(seed).standard_normal(at.size)
    wave = signals.tone(200, seconds, RATE, 0.2) + noise * (np.sin(2 * np.pi * 4.3 * at) > 0.6)
    return signals.columns(wave, 0.5 * wave).astype(np.float32)


def after(frames, following):
    return np.concatenate([np.zeros((frames, 2), np.float32), following])


PAUSES = [(0.0, pause) for pause in (1, 333, 480, HOP, 5_000, 60_001, 12 * RATE + 331)]


@pytest.mark.parametrize(("seconds", "pause"), [*PAUSES, (1.0, 40_001), (1.0, 96_123)])
def test_silence_only_delays_what_follows_once_vibration_has_faded(seconds, pause):
    one, other = bursts(seconds, seed=1), bursts(seed=2)
    got = signals.played(np.concatenate([one, after(pause, other)]), RATE)
    assert seconds or not got[:pause].any()
    wanted = signals.played(other, RATE)
    np.testing.assert_allclose(got[len(one) + pause :], wanted, rtol=0.0, atol=1e-9)


def test_the_core_begins_hops_where_its_oracle_does_and_a_short_gap_moves_none():
    rng = np.random.default_rng(3)
    pauses = rng.integers(0, 70_000, 6)
    frames = np.concatenate([after(pause, bursts(0.3, seed)) for seed, pause in enumerate(pauses)])
    frames[100_000:100_010, 1] = np.nan
    got = signals.in_blocks(frames, rng.integers(1, 3_000, len(frames) // 1_500), RATE)
    np.testing.assert_allclose(got, vibration_of(frames, RATE).samples, rtol=0.0, atol=1e-6)
    one, other = bursts(seed=1), bursts(seed=2)
    got = signals.played(np.concatenate([one, after(1_500, other)]), RATE)
    whole = len(one) // HOP * HOP
    np.testing.assert_allclose(got[:whole], signals.played(one, RATE)[:whole], rtol=0.0, atol=1e-9)
    assert np.abs(got).max() < 1.0


def test_the_reference_form_cuts_its_units_from_the_beginning_on():
    got = signals.played(after(333, bursts()), RATE, form="reference")
    wanted = signals.played(bursts(), RATE, form="reference")
    assert np.abs(got[333:] - wanted).max() > 1e-3

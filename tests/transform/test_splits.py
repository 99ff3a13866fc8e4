"""Any split of a stream into blocks gives the same bytes, whatever the form, rate and channels."""

import functools
import itertools

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.recordings import require_recordings
from tests.support.signals import (
    FORMS,
    burst,
    chirp,
    columns,
    five_tones,
    identical,
    in_blocks,
    joined,
    low_noise,
    made,
    one_sample,
    played,
    silence,
    square,
    tone,
    white_noise,
)

ODD_RATE = 37_123
"""A prime: no window, hop or spectrum comes out even."""

SAMPLERATES = (44_100, 48_000, ODD_RATE)
BLOCKSIZES = (7, 240, 256, 960, 4_096)
RATE_OF_FORM = list(zip(FORMS, itertools.cycle(SAMPLERATES)))
"""Every form, each at another rate; blocks of any one size cover all pairs of them."""


@functools.cache
def busy(samplerate, seconds=1.0):
    """Return sound that wakes every branch: silences, births and deaths, weak and strong peaks.

    Noise in the middle of the band and low noise around the image's threshold let neighbouring
    hops differ in whether they hold a peak at all, which a batch must not mix up.
    """
    return joined(
        silence(0.1, samplerate),
        tone(300, 0.1, samplerate, 0.7),
        # Long enough for the ringing to end (0.4 s) and the form to fall asleep.
        silence(0.62, samplerate),
        low_noise(0.6, samplerate, 0.04, seed=1),
        white_noise(0.2, samplerate, 0.4, seed=2),
        burst(1_000, 0.05, 0.35, samplerate, 0.9),
        one_sample(0.1, samplerate, 0.05),
        low_noise(0.3, samplerate, 0.02, seed=3),
        chirp(60, 11_000, 0.3, samplerate),
        square(90, 0.1, samplerate),
    )[: round(seconds * samplerate)]


def stereo(samplerate, seconds=1.0):
    sound = busy(samplerate, seconds)
    return columns(sound, 0.7 * sound[::-1])


def every(frames, total):
    return [frames] * (total // frames)


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("samplerate", SAMPLERATES)
@pytest.mark.parametrize("frames", BLOCKSIZES)
def test_blocks_of_any_one_size_give_the_bytes_of_one_block(form, samplerate, frames):
    sound = busy(samplerate, 2.8)
    whole = played(sound, samplerate, form=form)
    cut = in_blocks(sound, every(frames, sound.size), samplerate, form=form)
    assert whole.any()
    assert identical(cut, whole)


@pytest.mark.sweep
@pytest.mark.parametrize(("form", "samplerate"), RATE_OF_FORM)
def test_a_second_in_blocks_of_one_frame_gives_the_bytes_of_one_block(form, samplerate):
    sound = busy(samplerate, 2.8)[round(0.6 * samplerate) : round(1.6 * samplerate)]
    whole = played(sound, samplerate, form=form)
    cut = in_blocks(sound, every(1, sound.size), samplerate, form=form)
    assert identical(cut, whole)


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("frames", [7, 256, 960, 4_096])
def test_stereo_in_blocks_gives_the_bytes_of_one_block(form, per_channel, frames):
    sound = stereo(48_000, 1.6)
    options = {"form": form, "per_channel": per_channel}
    whole = played(sound, 48_000, **options)
    cut = in_blocks(sound, every(frames, len(sound)), 48_000, **options)
    assert identical(cut, whole)


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
def test_a_second_of_stereo_in_blocks_of_one_frame_gives_the_bytes_of_one_block(form):
    sound = stereo(44_100, 1.0)
    whole = played(sound, 44_100, form=form, per_channel=True)
    cut = in_blocks(sound, every(1, len(sound)), 44_100, form=form, per_channel=True)
    assert identical(cut, whole)


@pytest.mark.sweep
@pytest.mark.parametrize(("form", "samplerate"), RATE_OF_FORM)
@given(seed=st.integers(0, 2**32 - 1), typical=st.sampled_from([3, 40, 700, 5_000, 60_000]))
@settings(max_examples=8)
def test_random_splits_give_the_bytes_of_one_block(form, samplerate, seed, typical):
    sound = busy(samplerate, 2.8)
    whole = whole_of_busy(form, samplerate)
    lengths = np.random.default_rng(seed).exponential(typical, 1 + sound.size // typical)
    cut = in_blocks(sound, lengths.astype(int).tolist(), samplerate, form=form)
    assert identical(cut, whole)


@functools.cache
def whole_of_busy(form, samplerate):
    return played(busy(samplerate, 2.8), samplerate, form=form)


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
@given(
    kinds=st.lists(st.sampled_from(["silence", "noise", "low", "tone", "tones"]), min_size=1),
    level=st.sampled_from([0.005, 0.02, 0.1, 1.0]),
    lengths=st.lists(st.integers(0, 6_000), max_size=12),
    seed=st.integers(0, 1_000),
)
@settings(max_examples=40)
def test_any_split_of_any_mix_gives_the_bytes_of_one_block(form, kinds, level, lengths, seed):
    pieces = {
        "silence": lambda index: silence(0.25, 16_000),
        "noise": lambda index: white_noise(0.1, 16_000, 2 * level, seed + index),
        "low": lambda index: low_noise(0.1, 16_000, level, seed + index),
        "tone": lambda index: tone(60 * 1.3**index, 0.1, 16_000, level),
        "tones": lambda index: five_tones(0.1, 16_000, level),
    }
    sound = joined(*(pieces[kind](index) for index, kind in enumerate(kinds[:10])))
    whole = played(sound, 16_000, form=form)
    assert identical(in_blocks(sound, lengths, 16_000, form=form), whole)


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
def test_recordings_in_blocks_give_the_bytes_of_one_block(form):
    for path in require_recordings()[::3]:
        sound, samplerate = soundfile.read(path, always_2d=True)
        whole = played(sound, samplerate, form=form)
        for frames in (256, 1_000):
            cut = in_blocks(sound, every(frames, len(sound)), samplerate, form=form)
            assert identical(cut, whole), path.name


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
def test_noise_of_any_level_in_blocks_gives_the_bytes_of_one_block(form):
    # Levels at which hops with and without a strong low peak stand side by side in one batch.
    for rms in (0.01, 0.02, 0.04, 0.1):
        for sound in (low_noise(1.0, 48_000, rms), white_noise(1.0, 48_000, 2 * rms)):
            whole = played(sound, 48_000, form=form)
            for frames in (240, 1_000):
                cut = in_blocks(sound, every(frames, sound.size), 48_000, form=form)
                assert identical(cut, whole), f"rms {rms}, blocks of {frames}"


@pytest.mark.parametrize("form", FORMS)
def test_empty_blocks_change_nothing(form):
    sound = stereo(48_000, 0.6)
    transform = made(sound, 48_000, form=form)
    parts = []
    for first in range(0, len(sound), 500):
        nothing = transform.process(sound[:0])
        assert nothing.shape == (0, 1)
        parts.append(transform.process(sound[first : first + 500]))
    parts += [transform.process(sound[:0]), transform.finish()]
    assert identical(np.concatenate(parts), played(sound, 48_000, form=form))


@pytest.mark.sweep
@pytest.mark.parametrize("form", FORMS)
def test_asleep_and_awake_again_gives_the_same_bytes_in_any_blocks(form):
    samplerate = 44_100
    nap = silence(1.3, samplerate)
    # High and with soft ends: the band-pass rings on so little that the last windows are heard
    # only for what hops before them held.
    chirrup = tone(5_000, 0.1, samplerate, 0.5) * np.hanning(round(0.1 * samplerate))
    sound = joined(
        nap, tone(200, 0.2, samplerate), nap, white_noise(0.01, samplerate), nap, chirrup,
        nap, low_noise(0.2, samplerate, 0.03), nap,
    )  # fmt: skip
    whole = played(sound, samplerate, form=form)
    for frames in (97, 689, 690, 691, 20_000):
        cut = in_blocks(sound, every(frames, sound.size), samplerate, form=form)
        assert identical(cut, whole), f"blocks of {frames}"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("frames", [1, 7, 256, 4_096])
def test_each_block_gives_as_many_frames_as_it_takes(form, frames):
    sound = busy(48_000, 0.5)[:8_192]
    transform = made(sound, 48_000, form=form)
    for first in range(0, sound.size - frames, frames):
        assert transform.process(sound[first : first + frames]).shape == (frames, 1)
    assert transform.finish().shape == (transform.latency_frames, 1)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("per_channel", [False, True])
def test_the_layout_of_a_block_in_memory_changes_nothing(form, per_channel):
    sound = stereo(48_000, 1.2).astype(np.float32)
    options = {"form": form, "per_channel": per_channel}
    whole = played(sound, 48_000, **options)
    wide = np.zeros((len(sound), 6), np.float32)
    wide[:, [1, 4]] = sound
    assert identical(played(np.asfortranarray(sound), 48_000, **options), whole)
    assert identical(played(wide[:, 1::3], 48_000, **options), whole)
    assert identical(played(sound[::-1].copy()[::-1], 48_000, **options), whole)
    # float64 holds every float32, so the type alone makes no difference.
    assert identical(played(sound.astype(np.float64), 48_000, **options), whole)


@pytest.mark.parametrize("form", FORMS)
def test_a_block_is_not_written_to_and_may_be_reused_by_its_owner(form):
    sound = stereo(48_000, 1.0)
    whole = played(sound, 48_000, form=form)
    transform = made(sound, 48_000, form=form)
    buffer = np.empty((480, 2))
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
    assert identical(np.concatenate(parts), whole)


def test_two_transforms_at_once_do_not_touch_one_another():
    sound, other = busy(48_000, 1.0), white_noise(1.0, 48_000)
    one, two = made(sound, 48_000), made(other, 48_000)
    parts = []
    for first in range(0, sound.size, 1_000):
        parts.append(one.process(sound[first : first + 1_000]))
        two.process(other[first : first + 1_000])
    parts.append(one.finish())
    assert identical(np.concatenate(parts), played(sound, 48_000))

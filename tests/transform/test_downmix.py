import functools

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform.downmix import MonoMix
from device.layouts import CHANNELS_MAX, KNOWN, downmix, layout
from tests.oracle import vibration_of
from tests.support import signals
from tests.support.signals import FORMS, columns, identical, joined, level_db, played, silence, tone

RATE = 48_000
MINUS_3_DB = 0.5**0.5

every_form = pytest.mark.parametrize("form", FORMS)


@functools.cache
def speech_like(samplerate=RATE):
    """Return a sound of 0.6 s with beginnings, a voice's harmonics and a pause."""
    voiced = np.sum([tone(130.0 * k, 0.25, samplerate, 0.3 / k) for k in range(1, 12)], axis=0)
    hiss = signals.white_noise(0.1, samplerate, 0.2)
    return joined(voiced, silence(0.05, samplerate), hiss, tone(220.0, 0.2, samplerate, 0.4))


def placed(channels, **at):
    """Return a sound of so many channels, silent but for those named: FL=sound, ..."""
    sound = np.zeros((len(next(iter(at.values()))), channels))
    for position, samples in at.items():
        sound[:, layout(channels).index(position)] = samples
    return sound


def mixed(sound, samplerate=RATE):
    mix = MonoMix(downmix(sound.shape[1]), samplerate)
    return mix.process(np.array(sound.T, np.float64, order="C"))


@every_form
@pytest.mark.parametrize("channels", [count for count in KNOWN if count > 2])
def test_the_same_stereo_is_as_strong_in_every_layout(form, channels):
    left, right = speech_like(), 0.5 * speech_like() + signals.white_noise(0.6, RATE, 0.1)
    stereo = played(columns(left, right), RATE, form=form)
    surround = played(placed(channels, FL=left, FR=right), RATE, form=form)
    np.testing.assert_allclose(surround, stereo, rtol=0, atol=1e-12)
    assert stereo.any()


@every_form
def test_speech_in_the_centre_is_3_db_under_the_same_speech_in_mono(form):
    for channels in (5, 6, 8):
        centre = played(placed(channels, FC=speech_like()), RATE, form=form)
        assert identical(centre, played(MINUS_3_DB * speech_like(), RATE, form=form))


@every_form
def test_bass_and_surrounds_are_felt_3_db_lower_than_the_front(form):
    front = played(placed(6, FL=speech_like()), RATE, form=form)
    lower = played(placed(6, FL=MINUS_3_DB * speech_like()), RATE, form=form)
    for position in ("BL", "BR"):
        back = played(placed(6, **{position: speech_like()}), RATE, form=form)
        np.testing.assert_allclose(back, lower, rtol=0, atol=1e-12)
    assert np.abs(played(placed(6, LFE=tone(60, 0.6, RATE, 0.5)), RATE, form=form)).max() > 0.1
    assert front.any()


def test_every_layout_counts_both_sides_alike_and_leaves_out_no_channel():
    for channels in range(1, CHANNELS_MAX + 1):
        halves = downmix(channels)
        assert halves.shape == (channels, 2)
        assert halves.any(axis=1).all()
        if channels in KNOWN:
            assert halves[:, 0].sum() == pytest.approx(halves[:, 1].sum())
        else:
            assert (halves == 1.0 / channels).all()
    assert downmix(6).tolist() == [
        *([1.0, 0.0], [0.0, 1.0], [MINUS_3_DB, MINUS_3_DB], [MINUS_3_DB, MINUS_3_DB]),
        *([MINUS_3_DB, 0.0], [0.0, MINUS_3_DB]),
    ]
    assert downmix(7)[6].tolist() == [0.5, 0.5]


@pytest.mark.parametrize("channels", range(1, CHANNELS_MAX + 1))
def test_the_core_mixes_any_number_of_channels_as_its_oracle_does(channels):
    rng = np.random.default_rng(channels)
    sound = rng.uniform(-0.3, 0.3, (3_000, channels)) * rng.uniform(0, 1, channels)
    sound[1_500:, 1::2] = -sound[1_500:, : channels - channels % 2 : 2]
    expected = vibration_of(sound, 8_000).samples
    np.testing.assert_allclose(played(sound, 8_000), expected, rtol=0, atol=1e-9)


@every_form
@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 96_000])
@pytest.mark.parametrize("pair", ["FL FR", "BL BR"])
def test_opposite_channels_are_as_strong_as_equal_ones_after_a_tenth_second(form, samplerate, pair):
    sound = joined(tone(300, 0.5, samplerate, 0.3), silence(0.1, samplerate))
    one, other = pair.split()
    pairs = (placed(6, **{one: sound, other: sign * sound}) for sign in (1, -1))
    equal, opposite = (played(each, samplerate, form=form) for each in pairs)
    later = slice(round(0.1 * samplerate), round(0.5 * samplerate))
    assert level_db(opposite[later]) == pytest.approx(level_db(equal[later]), abs=1.0)


def test_opposite_channels_keep_their_attack():
    # From silence, and where sound that is alike in both channels was 20 dB weaker before.
    hit = signals.burst(200, 0.2, 0.35, RATE, 0.5) + signals.white_noise(0.35, RATE, 0.1) * (
        signals.burst(0.0001, 0.2, 0.35, RATE, 1.0) != 0.0
    )
    bed = signals.white_noise(0.35, RATE, 0.02, seed=7)
    for before in (0.0 * bed, bed):
        equal = played(columns(before + hit, before + hit), RATE)[:, 0]
        opposite = played(columns(before + hit, before - hit), RATE)[:, 0]
        latency = signals.made(columns(hit, hit), RATE).latency_frames
        attack = slice(round(0.2 * RATE) + latency, round(0.23 * RATE) + latency)
        peaks = [np.abs(one[attack]).max() for one in (equal, opposite)]
        assert peaks[1] > 0.8 * peaks[0]
        reached = [int(np.argmax(np.abs(one) > 0.5 * peaks[0])) for one in (equal, opposite)]
        assert reached[1] - reached[0] < 0.004 * RATE


@every_form
def test_what_is_alike_in_both_channels_keeps_the_bytes_of_mono(form):
    sound = speech_like()
    assert identical(played(columns(sound, sound), RATE, form=form), played(sound, RATE, form=form))


@pytest.mark.parametrize("highest_hz", [3_000, 23_000])
def test_no_beginning_of_independent_noise_is_taken_for_opposite(highest_hz):
    # The first samples of some are opposite, and of low noise for some time: 500 beginnings.
    rng, sections = np.random.default_rng(5), butter(2, highest_hz, fs=RATE, output="sos")
    for _ in range(500):
        noise = rng.normal(0.0, 10.0 ** rng.uniform(-5, -1), (3_000, 2))
        sound = sosfilt(sections, noise, axis=0)[1_000:]
        np.testing.assert_array_equal(mixed(sound), sound.mean(axis=1))


def test_sound_of_one_channel_and_sound_with_a_quarter_turn_keep_the_mean():
    at = np.arange(RATE) / RATE
    for hz in (30.0, 440.0, 3_000.0):
        left, turned = np.sin(2 * np.pi * hz * at), np.cos(2 * np.pi * hz * at)
        for sound in (columns(left, 0.0 * left), columns(left, turned)):
            np.testing.assert_array_equal(mixed(sound), sound.mean(axis=1))


def test_the_sum_of_powers_takes_over_without_a_step():
    # The right channel turns from equal to opposite and back in two seconds.
    at = np.arange(2 * RATE) / RATE
    left = 0.5 * np.sin(2 * np.pi * 100.0 * at)
    mono = mixed(columns(left, left * np.cos(np.pi * at)))
    steepest = 0.5 * 2 * np.pi * 100.0 / RATE
    assert np.abs(np.diff(mono)).max() < 1.2 * steepest
    middle = mono[round(0.95 * RATE) : round(1.05 * RATE)]
    assert level_db(middle) == pytest.approx(level_db(left), abs=0.5)

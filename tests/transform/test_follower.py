"""The loudness follower: strength by what is heard, whatever the volume, and nothing pumps."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import freqz

from audioflinger_hook.scenes.impacts import explosion
from audioflinger_hook.scenes.speech import speech
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.followers import LoudnessDesign, bin_weights, k_weight
from audioflinger_hook.transform.live.loudness import LoudnessFollower
from audioflinger_hook.transform.spectrum import Spectrum
from tests.support.signals import (
    columns,
    identical,
    in_blocks,
    joined,
    made,
    one_sample,
    played,
    silence,
    tone,
    white_noise,
)

RATE = 48_000
FOLLOWED = TransformParameters(loudness_db=30.0, level_law="energy")
LIVE = ("live", "live in NumPy")
HOP_S = 0.017


def level_db(vibration):
    """Return the level of a vibration, a full-scale sine at 0 dB."""
    return float(10 * np.log10(2 * np.mean(vibration**2) + 1e-30))


def talk(seconds, samplerate=RATE):
    """Return speech again and again, (frames,) float64, its peaks at 0.42."""
    once = speech(samplerate, np.random.default_rng(1), 0.42).mean(axis=1).astype(np.float64)
    return np.resize(once, round(seconds * samplerate))


def followed(loudness):
    """Return a follower and what it makes of a loudness in dB for each hop."""
    follower = LoudnessFollower(LoudnessDesign.of(FOLLOWED, HOP_S))
    return follower, [follower.strength(each) for each in loudness]


# --- what loud is


def test_the_weighting_is_that_of_bs_1770():
    # Its two filters at 48 kHz as the recommendation prints them, over what they do at 1 kHz.
    hz = np.array([1_000.0, 38.0, 100.0, 500.0, 2_000.0, 5_000.0, 12_000.0])
    shelf_a = [1.0, -1.69065929318241, 0.73248077421585]
    _, shelf = freqz([1.53512485958697, -2.69169618940638, 1.19839281085285], shelf_a, hz, fs=RATE)
    _, high_pass = freqz([1.0, -2.0, 1.0], [1.0, -1.99004745483398, 0.99007225036621], hz, fs=RATE)
    printed_db = 20 * np.log10(np.abs(shelf * high_pass))
    # The analogue shelf is not warped towards Nyquist's frequency.
    assert 10 * np.log10(k_weight(hz)) == pytest.approx(printed_db - printed_db[0], abs=0.1)


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 96_000])
@pytest.mark.parametrize("hz", [997.0, 1_003.3])
def test_a_full_scale_tone_of_1_khz_has_a_loudness_of_0_db(samplerate, hz):
    spectrum = Spectrum.of(FOLLOWED, samplerate)
    weights = bin_weights(spectrum, spectrum.bins)
    window = tone(hz, 1.0, samplerate)[: spectrum.window_frames]
    follower = LoudnessFollower(LoudnessDesign.of(FOLLOWED, HOP_S, weights))
    (loudness,) = follower.loudness_db(spectrum.transform(window[None]))
    assert loudness == pytest.approx(0.0, abs=0.05)


# --- how strong


@pytest.mark.parametrize("quiet_db", [-35.0, -25.0])
def test_20_phon_more_are_5_5_db_more_of_vibration_at_once(quiet_db):
    follower, steady = followed([quiet_db] * 3_000)
    louder = follower.strength(quiet_db + 20.0)
    assert 20 * np.log10(louder / steady[-1]) == pytest.approx(5.5, abs=0.1)


def test_a_steady_programme_vibrates_at_the_target():
    for loudness in (-12.0, -20.0, -38.0):
        _, strengths = followed([loudness] * 3_000)
        assert 20 * np.log10(strengths[-1]) == pytest.approx(-18.0, abs=0.05)


@pytest.mark.sweep
@pytest.mark.parametrize("form", LIVE)
@pytest.mark.parametrize("kind", ["speech", "tone", "noise"])
def test_the_same_programme_20_db_lower_is_felt_the_same_after_10_seconds(form, kind):
    seconds = 13.0
    sound = {
        "speech": lambda: talk(seconds, 16_000),
        "tone": lambda: tone(440, seconds, 16_000, 0.2),
        "noise": lambda: white_noise(seconds, 16_000, 0.3),
    }[kind]()
    last = slice(10 * 16_000, 13 * 16_000)
    loud, low = (
        level_db(played(volume * sound, 16_000, form=form, parameters=FOLLOWED)[last])
        for volume in (1.0, 0.1)
    )
    # Without it 20 dB. A difference of strength is felt from about 1 dB on.
    assert low == pytest.approx(loud, abs=1.0)


@pytest.mark.parametrize("volume", [1.0, 0.1])
def test_an_explosion_stands_above_speech_by_a_quarter_of_what_is_heard(volume):
    boom = explosion(RATE, np.random.default_rng(2), 0.86).mean(axis=1)
    vibration = played(volume * joined(talk(12.0), boom), RATE, parameters=FOLLOWED)[:, 0]
    pieces = [
        level_db(vibration[first : first + 19_200])
        for first in range(0, vibration.size - 19_200, 4_800)
    ]
    speech_db, boom_db = max(pieces[60:116]), max(pieces[118:])
    # It is heard 8 to 9 phon above: 2.3 dB; the programme's level has moved on meanwhile.
    assert 1.0 < boom_db - speech_db < 4.0


@pytest.mark.parametrize("volume", [0.1, 0.03])
def test_speech_at_low_volume_is_felt_where_the_hard_threshold_leaves_silence(volume):
    sound = volume * talk(6.0)
    unit = 2_229

    def silent(parameters):
        vibration = played(sound, RATE, parameters=parameters)[:, 0]
        whole = vibration[: vibration.size // unit * unit].reshape(-1, unit)
        return float((np.abs(whole).max(axis=1) < 1e-5).mean())

    # What begins is felt in either case: the rest of a syllable is what the threshold takes.
    assert silent(TransformParameters()) > 0.6
    assert silent(FOLLOWED) < 0.2


# --- what is not to be felt


@pytest.mark.parametrize("form", LIVE)
def test_silence_stays_exact_zeros_and_returns_after_sound(form):
    assert not played(silence(0.5, RATE), RATE, form=form, parameters=FOLLOWED).any()
    vibration = played(joined(talk(1.0), silence(1.5, RATE)), RATE, form=form, parameters=FOLLOWED)
    assert vibration[: RATE // 2].any()
    assert not vibration[-RATE // 2 :].any()


@pytest.mark.parametrize("form", LIVE)
def test_what_is_under_the_noise_floor_is_not_felt(form):
    # Principal is a tone from -70 dB on, at a C_th lowered by 30 dB: so it is the gate that acts.
    for sound in (tone(1_000, 1.0, RATE, 10 ** (-62 / 20)), white_noise(1.0, RATE, 1e-3)):
        assert not played(sound, RATE, form=form, parameters=FOLLOWED).any()
    assert played(
        tone(1_000, 1.0, RATE, 10 ** (-58 / 20)), RATE, form=form, parameters=FOLLOWED
    ).any()


@pytest.mark.parametrize("lift_db", [10.0, 30.0])
def test_quiet_noise_is_lifted_by_no_more_than_was_asked_for(lift_db):
    parameters = TransformParameters(loudness_db=lift_db, level_law="energy")
    sound = white_noise(12.0, 16_000, 10 ** (-54 / 20))
    plain = TransformParameters(threshold_hz=parameters.live_threshold_hz, level_law="energy")
    lifted, as_it_is = (
        level_db(played(sound, 16_000, parameters=each)[-16_000:]) for each in (parameters, plain)
    )
    assert lifted <= as_it_is + lift_db + 0.1
    assert lifted < -30.0  # a programme's own level gives -18


def test_noise_beside_a_programme_is_felt_less_and_less_and_the_programme_as_before():
    # Hiss 28 dB under the programme's level, in the third of a second between its words.
    programme = ([-18.0] * 40 + [-46.0] * 20) * 40
    _, strengths = followed(programme)
    assert max(strengths[-20:]) < 0.2 * max(strengths[40:60])
    assert max(strengths[-60:-20]) == pytest.approx(max(strengths[-120:-80]), rel=1e-3)


def test_a_steady_drone_is_not_taken_for_noise():
    _, strengths = followed([-30.0] * 12_000)
    assert min(strengths[6_000:]) == pytest.approx(max(strengths[6_000:]), rel=1e-9)
    assert strengths[-1] > 0.1


# --- rates


LOUDNESSES = st.lists(
    st.tuples(st.floats(-200, 60), st.integers(1, 200)), min_size=1, max_size=8
).map(lambda runs: [loudness for loudness, hops in runs for _ in range(hops)])


@given(LOUDNESSES)
def test_whatever_is_heard_the_programme_s_level_never_moves_faster_than_stated(loudness):
    follower = LoudnessFollower(LoudnessDesign.of(FOLLOWED, HOP_S))
    levels = [follower.programme_db]
    for each in loudness:
        follower.strength(each)
        levels.append(follower.programme_db)
    for one, other in pairwise(levels):
        assert -6.01 * HOP_S <= other - one <= 4.01 * HOP_S
    assert -40.0 <= min(levels) <= max(levels) <= -10.0


@given(LOUDNESSES)
def test_whatever_is_heard_strength_is_a_finite_number_within_reach(loudness):
    _, strengths = followed(loudness)
    # 70 phon over the programme's least level of -40 dB: more is no sound at all.
    assert all(0.0 <= each <= 10 ** ((-18 + 5.5 / 20 * 100) / 20) for each in strengths)


def test_after_what_was_loud_vibration_comes_back_by_9_db_a_second_at_most():
    _, strengths = followed([-12.0] * 600 + [-30.0] * 300)
    back_db = 20 * np.log10(np.array(strengths[600:]))
    rise_db_a_s = np.diff(back_db) / HOP_S
    # (1 - 5.5/20) of 10 dB a second, and what the programme's level adds.
    assert rise_db_a_s.max() < 7.25 + 6 * 5.5 / 20 + 0.1
    assert back_db[-1] > back_db[0] + 10.0


def test_a_steady_tone_is_felt_steady():
    vibration = played(tone(440, 12.0, RATE, 0.1), RATE, parameters=FOLLOWED)[:, 0]
    pieces = [
        level_db(vibration[first : first + 4_800]) for first in range(432_000, 576_000, 4_800)
    ]
    assert max(pieces) - min(pieces) < 0.2


@pytest.mark.exhaustive
def test_a_day_of_hops_leaves_the_follower_as_an_hour_does():
    follower = LoudnessFollower(LoudnessDesign.of(FOLLOWED, HOP_S))
    states = []
    for _ in range(2):
        for hop in range(200_000):
            follower.strength(-25.0 + 10.0 * (hop % 100 < 50))
        states.append((follower.programme_db, follower.floor_db, follower.loud_db))
    assert states[0] == states[1]


# --- hard cases and splits


@pytest.mark.parametrize("form", LIVE)
def test_damage_and_any_level_stay_finite_and_under_full_scale(form):
    damaged = white_noise(0.5, RATE, 0.5)
    damaged[::7] = np.nan
    damaged[1::7] = np.inf
    for sound in (
        damaged,
        np.full(RATE // 2, np.nan),
        white_noise(0.5, RATE, 1_000.0),
        white_noise(0.5, RATE, 1.0),
        one_sample(0.5, RATE, 0.2, 1_000.0),
        np.full(RATE // 2, 1e-310),
        np.full(RATE // 2, 1.0),
    ):
        vibration = played(sound, RATE, form=form, parameters=FOLLOWED)
        assert np.isfinite(vibration).all()
        assert np.abs(vibration).max() < 1.0


@pytest.mark.sweep
@pytest.mark.parametrize("form", LIVE)
@pytest.mark.parametrize("frames", [1, 7, 240, 256, 960, 4_096])
def test_blocks_of_any_size_give_the_bytes_of_one_block(form, frames):
    samplerate = 8_000
    quiet = 0.05 * talk(0.7, 16_000)[::2]
    sound = joined(talk(1.0, 16_000)[::2], silence(0.6, samplerate), quiet)
    if frames == 1:
        sound = sound[: samplerate // 2]
    whole = played(sound, samplerate, form=form, parameters=FOLLOWED)
    blocks = [frames] * (sound.size // frames)
    cut = in_blocks(sound, blocks, samplerate, form=form, parameters=FOLLOWED)
    assert identical(cut, whole)


@pytest.mark.sweep
@pytest.mark.parametrize("form", LIVE)
def test_a_stream_begun_anew_knows_nothing_of_the_one_before(form):
    transform = made(silence(0.1, RATE), RATE, form=form, parameters=FOLLOWED)
    loud, quiet = talk(1.0), 0.1 * talk(0.5)
    transform.process(loud)
    transform.finish()
    again = transform.process(quiet)
    fresh = made(quiet, RATE, form=form, parameters=FOLLOWED)
    assert identical(again, fresh.process(quiet))


def test_the_reference_form_knows_no_follower():
    sound = talk(0.5)
    plain = TransformParameters(level_law="energy")
    followed_too = played(sound, RATE, form="reference", parameters=FOLLOWED)
    assert identical(followed_too, played(sound, RATE, form="reference", parameters=plain))


# --- several voices


@pytest.mark.sweep
@pytest.mark.parametrize("form", LIVE)
def test_a_softer_side_stays_softer_by_a_quarter_of_what_is_heard(form):
    sound = white_noise(10.0, 16_000, 0.3)
    both = columns(sound, 0.1 * sound)
    felt = played(both, 16_000, form=form, per_channel=True, parameters=FOLLOWED)[-48_000:]
    left_db, right_db = level_db(felt[:, 0]), level_db(felt[:, 1])
    # By itself the right one would come up to the left one's strength.
    assert left_db - right_db == pytest.approx(5.5, abs=0.5)


@pytest.mark.parametrize("form", LIVE)
def test_voices_that_hear_the_same_are_what_one_alone_is(form):
    sound = joined(talk(0.6, 16_000), silence(0.5, 16_000), 0.1 * talk(0.4, 16_000))
    alone = played(sound, 16_000, form=form, parameters=FOLLOWED)
    both = columns(sound, sound)
    together = played(both, 16_000, form=form, per_channel=True, parameters=FOLLOWED)
    for side in (0, 1):
        assert identical(together[:, side].copy(), alone[:, 0])


@pytest.mark.sweep
@pytest.mark.parametrize("form", LIVE)
@pytest.mark.parametrize("frames", [7, 256, 5_000])
def test_several_voices_in_blocks_give_the_bytes_of_one_block(form, frames):
    samplerate = 8_000
    left = joined(talk(0.8, 16_000)[::2], silence(0.7, samplerate), tone(300, 0.5, samplerate, 0.4))
    both = columns(left, 0.05 * left[::-1], white_noise(2.0, samplerate, 0.01))
    options = {"form": form, "per_channel": True, "parameters": FOLLOWED}
    blocks = [frames] * (len(both) // frames)
    assert identical(
        in_blocks(both, blocks, samplerate, **options), played(both, samplerate, **options)
    )

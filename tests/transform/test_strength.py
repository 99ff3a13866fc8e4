from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfilt

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.scenes.sounds import explosion
from audioflinger_hook.scenes.speech import speech
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.mapping import VibrationMapping
from device.rig import CONSUMER, PAPER
from device.rig.actuator import LinearActuator
from tests.oracle import settings_of
from tests.oracle.loudness import loudness
from tests.oracle.strength import Strength
from tests.oracle.voice import Voice
from tests.support import signals
from tests.support.signals import best_sinusoid, identical, joined, level_db, played, silence, tone
from tests.transform.test_kernel import assert_agree

RATE = 48_000
FOLLOWED = TransformParameters(loudness_db=30.0, amplitude_mapping="energy")
WIDE = replace(FOLLOWED, loudness_db=54.0, loudness_floor_db=-75.0)
"""As far as the profiles go."""
LEVELLED = replace(parameters_of("cinema"), strength="rig", resonance_hz=90.0, resonance_q=4.0)

S = settings_of(LiveDesign.of(FOLLOWED, RATE))
WIDE_S = settings_of(LiveDesign.of(replace(WIDE, rise_db=0.0), RATE))
SLOPE = FOLLOWED.dynamics
TICK_S = S.tick_s


def decibels(strength):
    return 20 * np.log10(np.asarray(strength))


def talk(seconds, samplerate=RATE):
    """Return speech again and again, (frames,) float64, its peaks at 0.42."""
    once = speech(samplerate, np.random.default_rng(1), 0.42).mean(axis=1).astype(np.float64)
    return np.resize(once, round(seconds * samplerate))


OTHERS = [name for name in PROFILES if name != "paper"]


def ticks(seconds):
    return round(seconds / TICK_S)


def followed(levels_db, s=WIDE_S, strength=None):
    """Return a follower and what it makes of a loudness in dB for each tick, all of it in one
    group."""
    strength, groups = strength or Strength(s), np.zeros(s.loudness_groups.size - 1)
    found = []
    for loudness_db in levels_db:
        groups[3] = 2.0 ** ((loudness_db + 54.0) / 10.0)
        found.append(strength.follow(loudness_db, float(groups.sum()), groups))
    return strength, np.array(found)


def phon(sound, parameters=FOLLOWED, samplerate=RATE):
    """Return the loudness level of a sound's end."""
    s = settings_of(LiveDesign.of(parameters, samplerate))
    voice, ends = Voice(s), np.arange(s.tick_frames, sound.size, s.tick_frames)
    voice.hear(lfilter(s.band_b, s.band_a, sound), ends)
    return 94.0 + voice.loudness[-1][0]


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 96_000])
@pytest.mark.parametrize("hz", [997.0, 1_003.3])
def test_a_tone_of_1_khz_has_as_many_phon_as_dB_of_sound_pressure(samplerate, hz):
    levels = np.arange(40.0, 95.0, 9.0)
    amplitudes = 10 ** ((levels - 94) / 20)
    tones = [tone(hz, 0.1, samplerate, amplitude) for amplitude in amplitudes]
    found = [phon(one, samplerate=samplerate) for one in tones]
    # The threshold in quiet is 15 dB lower than in ISO 532-1, which adds 1.1 to 2.4 phon. A window
    # of 5 ms spreads a tone over neighbouring bands, which adds up to 5 more, most where it is
    # soft.
    assert (found - levels > 1.0).all()
    assert (found - levels < 7.5).all()
    assert np.diff(found) == pytest.approx(np.diff(levels), abs=2.5)


ISO_PHON = {500.0: 63.6, 1e3: 64.4, 2e3: 66.7, 4e3: 70.35, 8e3: 61.7}
"""What MoSQITo's loudness_zwst gives for tones at 64 dB."""
DEEP_PHON = {31.5: 60.7, 63.0: 64.0, 125.0: 67.9, 1e3: 69.7}
"""By ISO 532-1 22, 46, 58 and 64 phon: deep sound counts for more than the ear alone hears."""


def test_loudness_is_that_of_iso_532_1_but_deep_tones_are_louder_and_so_is_noise():
    found = {hz: phon(tone(hz, 0.1, RATE, 10 ** (-30 / 20)), WIDE) for hz in (ISO_PHON | DEEP_PHON)}
    # The lower threshold adds up to 3 phon, short windows up to 5.
    for hz, iso_phon in ISO_PHON.items():
        assert found[hz] == pytest.approx(iso_phon + 2, abs=5.0)
    for hz, deep_phon in DEEP_PHON.items():
        assert found[hz] == pytest.approx(deep_phon, abs=1.5)
    noise = signals.white_noise(0.1, RATE, 0.1)
    same = tone(1_000, 0.1, RATE, float(np.sqrt(2) * noise.std()))
    assert phon(noise) > phon(same) + 6.0


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 40.0))
def test_more_of_any_sound_is_never_softer(seed, more_db):
    random = np.random.default_rng(seed)
    bands = 10.0 ** random.uniform(-1, 8) * random.exponential(size=20) ** random.uniform(0.2, 8.0)
    before, after = loudness(WIDE_S, np.stack((bands, 10 ** (more_db / 10) * bands)))[0]
    assert np.isfinite(before)
    assert before <= after + 1e-9


@pytest.mark.parametrize("quiet_db", [-50.0, -40.0, -30.0])
@pytest.mark.parametrize("dynamics", [0.1, 0.275, 0.63, 1.0])
def test_20_phon_more_are_20_times_the_dynamics_more_of_vibration_at_once(quiet_db, dynamics):
    s = settings_of(LiveDesign.of(replace(WIDE, dynamics=dynamics, rise_db=0.0), RATE))
    strength, steady = followed([quiet_db] * ticks(5.0), s)
    _, louder = followed([quiet_db + 20.0], s, strength)
    assert decibels(louder[0] / steady[-1]) == pytest.approx(dynamics * 20.0, abs=0.1)


def test_a_smaller_rise_lacks_the_dead_band_and_small_jitter_is_hardly_felt():
    strength, steady = followed([-40.0] * ticks(5.0), WIDE_S)
    _, louder = followed([-32.0], WIDE_S, strength)
    wanted = WIDE_S.slope * (8.0 - WIDE_S.jitter)
    assert decibels(louder[0] / steady[-1]) == pytest.approx(wanted, abs=0.1)
    _, strengths = followed(-20.0 + np.random.default_rng(0).uniform(-1.2, 1.2, 4_000))
    # Of 2.4 dB the law would make 0.66 dB.
    assert np.ptp(decibels(strengths[2_000:])) < 0.3


@pytest.mark.parametrize("lowest_db", [-40.0, -50.0, -60.0])
@pytest.mark.parametrize("pause_s", [0.0, 60.0])
def test_a_crescendo_of_30_db_is_felt_as_one_upwards_and_downwards(lowest_db, pause_s):
    strength, _ = followed([lowest_db] * ticks(pause_s))
    up = np.linspace(lowest_db, lowest_db + 30.0, ticks(16.0))
    risen, fallen = (decibels(followed(one, WIDE_S, strength)[1]) for one in (up, up[::-1]))
    # What the programme's level moves meanwhile: half of it, 20 dB lower, is 17 %.
    assert risen[-1] - risen[ticks(2.5)] == pytest.approx(30.0 * 13.5 / 16.0 * SLOPE, rel=0.25)
    assert fallen[-1] - fallen[0] == pytest.approx(-30.0 * SLOPE, rel=0.25)


@pytest.mark.parametrize("soft_db", [-45.0, -60.0])
def test_a_stream_that_begins_softly_has_its_programme_within_two_seconds(soft_db):
    strength, _ = followed([soft_db] * ticks(2.1))
    # It stays 10 dB over what is heard, and a fifth of the way from -20 dB is left.
    near_db = soft_db + 10.0
    assert near_db < strength.programme_db < near_db + 0.3 * (-20.0 - near_db) + 1.0
    slower, _ = followed([soft_db] * ticks(2.0), WIDE_S, strength)
    assert slower.programme_db > strength.programme_db - 1.0


def test_a_quiet_scene_moves_the_programme_by_a_quarter_of_a_db_a_second_at_most():
    strength, _ = followed([-20.0] * ticks(5.0))
    before_db = strength.programme_db
    followed([-60.0] * ticks(10.0), WIDE_S, strength)
    assert before_db - 2.8 < strength.programme_db < before_db


def test_hiss_far_under_the_programme_is_not_felt_and_the_next_word_is_no_stronger():
    strength, words = followed([-20.0] * ticks(20.0))
    _, hiss = followed([-64.0] * ticks(30.0), WIDE_S, strength)
    assert hiss[ticks(0.5) :].max() < 0.003 * words[-1]
    _, again = followed([-20.0] * ticks(1.0), WIDE_S, strength)
    assert decibels(again[ticks(0.2)] / words[-1]) == pytest.approx(0.0, abs=0.5)


def test_a_rise_in_one_group_of_bands_is_felt_though_loudness_hardly_grows():
    def heard(rise_db):
        s = settings_of(LiveDesign.of(replace(WIDE, rise_db=rise_db), RATE))
        strength, groups = Strength(s), np.full(s.loudness_groups.size - 1, 0.05)
        groups[4] = 20.0
        level_db = -54.0 + 10.0 * np.log2(groups.sum())
        for _ in range(ticks(3.0)):
            before = strength.follow(level_db, float(groups.sum()), groups)
        groups[0] = 2.0  # by a tenth of all
        after = [strength.follow(level_db + 1.2, float(groups.sum()), groups) for _ in range(20)]
        return decibels(max(after) / before)

    assert heard(0.0) < 0.5
    assert heard(5.0) > 3.0


@pytest.mark.parametrize("profile", ["cinema", "game", "music"])
@pytest.mark.parametrize("volume", [1.0, 0.1])
def test_an_explosion_stands_above_speech_by_half_of_what_is_heard(profile, volume):
    boom = explosion(RATE, np.random.default_rng(2), 0.86).mean(axis=1)
    sound = volume * joined(0.3 * talk(6.0), boom)
    vibration = played(sound, RATE, parameters=parameters_of(profile))[:, 0]
    begins = range(48_000, vibration.size - 6_000, 3_000)
    pieces = [level_db(vibration[at : at + 6_000]) for at in begins]
    # It is heard 28 phon above the speech in this scene. Amplitudes say less than what is felt: the
    # explosion vibrates where the body feels best.
    assert max(pieces[80:]) - max(pieces[:75]) > 4.5


@pytest.mark.parametrize("volume", [0.1, 0.03])
def test_speech_at_low_volume_is_felt_where_the_hard_threshold_leaves_silence(volume):
    sound, unit = volume * talk(6.0), 2_229

    def silent(parameters):
        vibration = played(sound, RATE, parameters=parameters)[:, 0]
        whole = vibration[: vibration.size // unit * unit].reshape(-1, unit)
        return float((np.abs(whole).max(axis=1) < 1e-5).mean())

    # What begins is felt in either case: the rest of a syllable is what the threshold takes.
    assert silent(TransformParameters()) > 0.6
    assert silent(FOLLOWED) < 0.2


def test_equal_loudness_is_felt_equally_strong_at_every_vibration_frequency():
    parameters = replace(WIDE, strength="felt", mapping="jnd", band_low_hz=20.0)
    mapping, felt_db = VibrationMapping.of(parameters), []
    for hz in (30.0, 60.0, 120.0, 200.0):
        audio_hz = mapping.audio_hz(hz)
        softest, loudest = -90.0, 0.0
        for _ in range(20):
            middle = (softest + loudest) / 2
            sound = tone(audio_hz, 0.1, RATE, 10 ** (middle / 20))
            is_soft = phon(sound, parameters) < 59.0
            softest, loudest = (middle, loudest) if is_soft else (softest, middle)
        sound = tone(audio_hz, 1.5, RATE, 10 ** (softest / 20))
        vibration = played(sound, RATE, parameters=parameters)[RATE // 2 : 3 * RATE // 2, 0]
        _, amplitude, _ = best_sinusoid(*signals.thinned(vibration, RATE), hz)
        felt_db.append(20 * np.log10(amplitude * 40.0 / hz))
    assert max(felt_db) - min(felt_db) < 1.0
    # Without it the same amplitude would be felt 16 dB weaker at 200 Hz than at 30.


@pytest.mark.parametrize("rig", [PAPER, CONSUMER])
def test_strength_rig_levels_what_a_resonant_seat_makes_of_tones(rig):
    spread_db = {}
    for strength in ("felt", "rig"):
        parameters = replace(parameters_of("cinema"), strength=strength)
        settings = Settings(rig=rig.name, parameters=parameters, said=("strength",))
        mapping, felt_db = VibrationMapping.of(parameters), []
        for hz in (40.0, 80.0, 160.0, 400.0, 1_000.0, 3_000.0):
            sound = tone(hz, 2.0, RATE, 0.03)
            drive = played(sound, RATE, parameters=settings.transform_parameters)[:, 0]
            moved = LinearActuator(rig.actuator, RATE).move(drive.astype(np.float64))
            # Felt is acceleration by the inverse of its frequency.
            felt = np.std(moved.acceleration_m_s2[RATE:]) / mapping.vibration_hz(np.array([hz]))
            felt_db.append(float(decibels(felt[0])))
        spread_db[strength] = np.ptp(felt_db)
    assert spread_db["rig"] < 0.5 * spread_db["felt"], spread_db


@pytest.mark.parametrize("parameters", [FOLLOWED, parameters_of("cinema")])
def test_silence_stays_exact_zeros_and_returns_after_sound(parameters):
    assert not played(silence(0.5, RATE), RATE, parameters=parameters).any()
    vibration = played(joined(talk(1.0), silence(1.8, RATE)), RATE, parameters=parameters)
    assert vibration[: RATE // 2].any()
    assert not vibration[-RATE // 2 :].any()


def test_what_is_under_the_loudness_floor_is_not_felt():
    # The tone is loud enough for the threshold of principal frequencies, so the gate acts. It fades
    # in: one that begins at once is a soft click, which is louder.
    faded = np.minimum(1.0, np.arange(RATE // 2) / (RATE // 10))
    for sound, felt in (
        (10 ** (-70 / 20) * tone(1_000, 0.5, RATE), False),
        (10 ** (-57 / 20) * tone(1_000, 0.5, RATE), True),
        (signals.white_noise(0.5, RATE, 5e-5), False),
        (signals.white_noise(0.5, RATE, 3e-3), True),
    ):
        assert played(faded * sound, RATE, parameters=FOLLOWED).any() == felt


@pytest.mark.parametrize("profile", ["cinema", "game", "music"])
def test_hum_and_dither_of_a_quiet_room_are_not_felt(profile):
    samplerate, seconds = 16_000, 3.0
    faded = np.minimum(1.0, np.arange(round(seconds * samplerate)) / samplerate)
    for each in (50.0, 60.0):
        hum = sum(tone(each * n, seconds, samplerate, 1.5e-4 / n) for n in (1, 2, 3, 4))
        assert not played(faded * hum, samplerate, parameters=parameters_of(profile)).any()
    # Of 16 bits, triangular.
    dither = sum(signals.white_noise(seconds, samplerate, 2.0**-16, seed) for seed in (1, 2))
    assert not played(faded * dither, samplerate, parameters=parameters_of(profile)).any()


@pytest.mark.parametrize("lift_db", [10.0, 30.0])
def test_quiet_noise_is_lifted_by_no_more_than_was_asked_for(lift_db):
    parameters = TransformParameters(loudness_db=lift_db, amplitude_mapping="energy")
    sound = signals.white_noise(3.0, 16_000, 10 ** (-54 / 20))
    lowest_hz = parameters.live_threshold_hz
    plain = TransformParameters(threshold_hz=lowest_hz, amplitude_mapping="energy")
    lifted, as_it_is = (
        level_db(played(sound, 16_000, parameters=each)[-16_000:]) for each in (parameters, plain)
    )
    assert lifted <= as_it_is + lift_db + 0.1


LOUDNESSES = st.lists(
    st.tuples(st.floats(-200, 60), st.integers(1, 200)), min_size=1, max_size=8
).map(lambda runs: [loudness for loudness, count in runs for _ in range(count)])


@given(LOUDNESSES)
def test_whatever_is_heard_strength_is_a_finite_number_within_reach(levels_db):
    strength, strengths = followed(levels_db, S)
    # 100 phon over the programme's least level of -40 dB, and a rise.
    assert all(0.0 <= each <= 10 ** ((-18 + SLOPE * 100 + 5.0) / 20) for each in strengths)
    assert -40.0 <= strength.programme_db <= -10.0


def jumping(wave):
    return wave * np.where(np.arange(wave.size) // RATE % 2, 0.01, 1.0)


MINUTE_S = np.arange(60 * RATE) / RATE
NOISE = np.random.default_rng(0).uniform(-1.0, 1.0, MINUTE_S.size)
DAMAGED = 0.5 * NOISE[: RATE // 3]
DAMAGED[::7], DAMAGED[1::7] = np.nan, np.inf
WORST = {
    "no sample": np.zeros(0),
    "one sample": np.ones(1),
    "two samples": np.full(2, 0.5),
    "silence": np.zeros(RATE),
    "0.05 s": 0.5 * np.sin(600.0 * np.pi * np.arange(RATE // 20) / RATE),
    "a constant": np.full(RATE, 0.9),
    "denormal numbers": np.full(RATE // 4, 1e-310),
    "nothing but NaN": np.full(RATE // 4, np.nan),
    "damaged noise": DAMAGED,
    "full-scale noise": np.random.default_rng(0).choice([-1.0, 1.0], 5 * RATE),
    "noise 60 dB over": 1e3 * NOISE[: RATE // 3],
    "one sample 60 dB over": signals.one_sample(0.4, RATE, 0.2, 1e3),
    "a tone that jumps": jumping(0.9 * np.sin(440.0 * np.pi * MINUTE_S)),
    "noise that jumps": jumping(NOISE),
}


@pytest.mark.parametrize("profile", OTHERS)
@pytest.mark.parametrize("name", WORST)
def test_whatever_plays_vibration_is_bounded_and_has_no_steps(profile, name):
    vibration = played(signals.columns(WORST[name]), RATE, parameters=parameters_of(profile))[:, 0]
    assert np.isfinite(vibration).all()
    assert np.abs(vibration).max() < 1.0
    # a step of 2 % of full scale has 2 % at once over 1 kHz, a vibration of 220 Hz nearly nothing
    above = sosfilt(butter(4, 1_000.0, "highpass", fs=RATE, output="sos"), vibration)
    assert np.abs(above).max() < 0.02


@pytest.mark.parametrize("profile", OTHERS)
@pytest.mark.parametrize("samplerate", [8_000, RATE])
def test_a_file_that_begins_amid_a_sound_begins_with_a_fade(profile, samplerate):
    sound = tone(440, 1.0, samplerate, 0.5) + signals.white_noise(1.0, samplerate, 0.1)
    transform = signals.opened(samplerate, 1, "live", parameters=parameters_of(profile))
    late = transform.latency_frames
    vibration = transform.process(np.concatenate((sound, np.zeros(late)))[:, None])[:, 0]
    assert not vibration[:late].any()
    peak = np.abs(vibration).max()
    assert np.abs(np.diff(vibration[late - 1 :])).max() < 0.02 * peak * RATE / samplerate + 0.01
    assert abs(vibration[late]) < 0.02 * peak


@pytest.mark.parametrize("parameters", [FOLLOWED, WIDE, parameters_of("cinema"), LEVELLED])
def test_the_core_follows_as_its_oracle_does(parameters):
    samplerate = 16_000
    quiet, broken = 0.02 * talk(1.0, samplerate), signals.white_noise(0.3, samplerate, 0.4)
    broken[::50] = np.nan
    boom = explosion(samplerate, np.random.default_rng(2), 0.86).mean(axis=1)[:samplerate]
    sound = joined(talk(1.5, samplerate), quiet, silence(0.7, samplerate), boom, broken, quiet)
    # A bang far over full scale, which is no other volume, and a noise that is one.
    loud = signals.white_noise(1.5, samplerate, 30.0)
    sound = joined(sound, loud[: samplerate // 4], quiet, quiet, loud, quiet)
    assert_agree(sound, samplerate, parameters=parameters)


def test_the_reference_form_follows_no_loudness_and_suppresses_no_speech():
    sound, plain = talk(1.0), TransformParameters(amplitude_mapping="energy")
    expected = played(sound, RATE, form="reference", parameters=plain)
    for parameters in (FOLLOWED, replace(plain, speech_suppression_db=18.0)):
        assert identical(played(sound, RATE, form="reference", parameters=parameters), expected)


@pytest.mark.sweep
def test_a_softer_side_stays_softer_by_the_law_as_voices_share_the_programme_s_level():
    loud, soft = tone(440, 6.0, 8_000, 0.3), tone(440, 6.0, 8_000, 0.03)
    together = played(signals.columns(loud, soft), 8_000, per_channel=True, parameters=WIDE)
    voices = (*together.T, played(soft, 8_000, parameters=WIDE)[:, 0])
    left_db, right_db, alone_db = (level_db(each[40_000:48_000]) for each in voices)
    # 20 dB of level are 20 phon; the programme is that of the louder side.
    assert left_db - right_db == pytest.approx(20.0 * SLOPE, abs=0.5)
    # By itself the soft side would come nearer to the target.
    assert right_db < alone_db - 0.25


def test_voices_that_hear_the_same_are_what_one_is_and_a_steady_tone_is_felt_steady():
    sound = joined(talk(0.6, 16_000), silence(0.5, 16_000), 0.1 * talk(0.4, 16_000))
    alone = played(sound, 16_000, parameters=FOLLOWED)
    together = played(signals.columns(sound, sound), 16_000, per_channel=True, parameters=FOLLOWED)
    for side in (0, 1):
        assert identical(together[:, side].copy(), alone[:, 0])
    vibration = played(tone(440, 6.0, RATE, 0.1), RATE, parameters=FOLLOWED)[:, 0]
    pieces = [level_db(piece) for piece in vibration[144_000:288_000].reshape(-1, 4_800)]
    assert max(pieces) - min(pieces) < 0.2

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.exports.glides import first_onset_slot
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.haptic import CoreStream
from tests.oracle import settings_of
from tests.oracle.partials import Partials
from tests.support import onset_detection, signals
from tools.bench.measures.vibration import onset_lag_s

RATE = 48_000
PROFILES = ("cinema", "game", "music")
CINEMA = parameters_of("cinema")
ONSET_SLOT = first_onset_slot(LiveDesign.of(CINEMA, RATE))


def drum(hz, seconds=0.5, decay_s=0.08, amplitude=0.6):
    time_s = np.arange(round(seconds * RATE)) / RATE
    skin = np.sin(2 * np.pi * hz * time_s) * np.exp(-time_s / decay_s)
    stick = np.random.default_rng(0).standard_normal(time_s.size) * np.exp(-time_s / 0.01)
    return amplitude * (0.8 * skin + 0.1 * stick)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("hz", [60.0, 110.0, 240.0])
def test_a_drum_is_felt_most_as_it_is_struck(profile, hz):
    sound = signals.joined(signals.silence(0.3, RATE), drum(hz), signals.silence(0.3, RATE))
    parameters, late_ms = parameters_of(profile), []
    for parts in (sound, 0.1 * sound):
        level = signals.envelope(signals.played(parts, RATE, parameters=parameters)[:, 0], RATE)
        late_ms.append(1e3 * float(np.argmax(level)) / RATE - 300.0)
    # The latency is 9 ms, and the envelope of a sudden rise is at its top some ms later.
    assert max(late_ms) < 40.0, late_ms


@pytest.mark.parametrize("profile", PROFILES)
def test_a_shot_s_noise_is_felt_most_as_it_begins(profile):
    late_ms = []
    for seed in range(15):
        decaying = np.exp(-np.arange(RATE // 2) / RATE / 0.06)
        noise = np.random.default_rng(seed).standard_normal(decaying.size)
        shot = np.clip(0.5 * noise * decaying, -1.0, 1.0)
        sound = signals.joined(signals.silence(0.3, RATE), shot, signals.silence(0.2, RATE))
        vibration = signals.played(sound, RATE, parameters=parameters_of(profile))[:, 0]
        # Felt is acceleration by the inverse of its frequency.
        velocity = lfilter([1.0], [1.0, -np.exp(-2 * np.pi * 20.0 / RATE)], vibration)
        late_ms.append(1e3 * float(np.argmax(signals.envelope(velocity, RATE))) / RATE - 300.0)
    # The latency is 9 ms. Partials that beat have later peaks, which are lower than the first.
    assert np.median(late_ms) < 25.0, late_ms


def test_a_blow_adds_to_the_tone_that_sounds_whatever_its_phase():
    hum, deepest = signals.tone(90.0, 1.2, RATE, 0.02), []
    for delay in range(0, 540, 90):
        at, sound = RATE // 2 + delay, hum.copy()
        sound[at:] += drum(95.0, 1.0)[: sound.size - at]
        level = signals.envelope(signals.played(sound, RATE, parameters=CINEMA)[:, 0], RATE)
        before = level[at - 4_000 : at - 1_500].mean()
        # From the first tick that can be felt to the end of the hop that is under way.
        deepest.append(level[at : at + 1_200].min() / before)
    # A sixth is as little as is noticed of the level of such a vibration.
    assert min(deepest) > 0.82, deepest


def test_a_partial_of_an_onset_has_frequency_and_phase_of_what_it_joins():
    sound, at = signals.tone(90.0, 1.0, RATE, 0.02), RATE // 2 + 300
    sound[at:] += drum(95.0)[: sound.size - at]
    joins = {}
    for merge_ratio in (CINEMA.merge_ratio, 0.0):
        transform = signals.opened(RATE, 1, parameters=replace(CINEMA, merge_ratio=merge_ratio))
        transform.take_glides()
        transform.process(sound)
        glides = transform.take_glides()
        fresh = glides[(glides[:, 3] >= ONSET_SLOT) & (glides[:, 0] >= at)][0]
        [other] = glides[(glides[:, 0] == fresh[0]) & (glides[:, 3] < ONSET_SLOT)]
        # A tone that goes on: its frequency hardly glides.
        assert other[5] == pytest.approx(other[4], abs=0.01)
        turns = other[8] - fresh[8]
        same = abs(fresh[4] - other[5]) < 0.01 and abs((turns + 0.5) % 1.0 - 0.5) < 1e-3
        joins[merge_ratio] = same
    assert joins == {CINEMA.merge_ratio: True, 0.0: False}


def test_amplitudes_that_waver_by_a_twelfth_are_steadied_where_partials_are_merged():
    swings = {}
    for merge_ratio in (0.6, 0.0):
        design = LiveDesign.of(replace(CINEMA, merge_ratio=merge_ratio), RATE)
        partials = Partials(settings_of(design))
        for hop in range(80):
            amplitude = np.array([0.2 * (1.0 + (0.04 if hop % 2 else -0.04))])
            partials.follow(hop, np.array([50.0]), amplitude, 0.5, 1.0, lambda _: 0.0)
        swings[merge_ratio] = np.ptp([one[5] for one in partials.glides[40:]]) / 0.2
    assert swings[0.6] < 0.03
    assert swings[0.0] > 0.07


def test_treble_at_full_scale_loses_less_to_the_limiter_than_it_would_unmoved():
    parameters, spread = parameters_of("music"), signals.white_noise(1.0, RATE, 0.5)
    levels = []
    for most in (0.0, 4.0):
        design = LiveDesign.of(parameters, RATE)
        strength = replace(design.strength, concentrated=most, programme_start=-30.0)
        stream = CoreStream(replace(design, strength=strength), 1, False)
        felt = stream.process(spread[:, None])[RATE // 2 :, 0]
        levels.append(signals.level_db(np.cumsum(felt) * 2 * np.pi * 40.0 / RATE))
    assert levels[1] > levels[0] + 1.0


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("hz", [25.0, 30.0, 35.0, 40.0])
def test_a_deep_tone_at_12_db_under_full_scale_is_felt_at_18(profile, hz):
    sound = signals.tone(hz, 6.0, RATE, 0.25)
    vibration = signals.played(sound, RATE, parameters=parameters_of(profile))[:, 0]
    assert signals.level_db(vibration[-2 * RATE :]) == pytest.approx(-18.0, abs=4.0)


@pytest.mark.parametrize("profile", PROFILES)
def test_hiss_that_nobody_hears_is_not_felt_however_long_it_lasts(profile):
    hiss = signals.white_noise(100.0, RATE)
    hiss *= 10 ** (-82 / 20) / hiss.std()
    vibration = signals.played(hiss, RATE, parameters=parameters_of(profile))[:, 0]
    assert signals.level_db(vibration) < -80.0


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("a_second", [1, 2, 5, 10, 20, 30, 40, 50])
def test_clicks_at_any_rate_stay_finite_and_are_never_stronger_than_a_few_alone(profile, a_second):
    sound = signals.silence(4.0, RATE)
    sound[RATE // 10 :: round(RATE / a_second)] = 0.5
    parameters = parameters_of(profile)
    kernel = signals.played(sound, RATE, parameters=parameters)[:, 0]
    beginning = sound[: RATE // 2] * (np.arange(RATE // 2) < RATE // 8)
    one = signals.played(beginning, RATE, parameters=parameters)
    assert np.isfinite(kernel).all()
    assert kernel.any()
    # Loudness of 50 clicks in a second is 20 phon over that of one at most.
    assert np.abs(kernel).max() < np.abs(one).max() * 10 ** (20 * parameters.dynamics / 20) * 1.5


PARAMETERS = TransformParameters()


def felt(sound, rate=RATE, onsets=True):
    """Return the vibration of a mono sound, as late as it comes."""
    design = LiveDesign.of(PARAMETERS, rate, find_onsets=onsets)
    return CoreStream(design, 1, False).process(sound[:, None])[:, 0]


def level(vibration, at_s, until_s):
    strength, rate = signals.thinned(vibration, RATE)
    part = slice(round(at_s * rate), round(until_s * rate))
    return float(signals.envelope(strength, rate)[part].mean())


@pytest.mark.parametrize("audio_hz", [80.0, 150.0, 300.0, 1_000.0, 5_000.0])
@pytest.mark.parametrize("onset_s", [0.3, 0.3107])
@pytest.mark.parametrize("amplitude", [0.05, 0.3, 1.0])
def test_a_burst_out_of_a_faint_noise_is_felt_within_12_ms(audio_hz, onset_s, amplitude):
    # With noise before it the burst begins anywhere in a tick: up to 2 ms later than from silence.
    sound = signals.burst(audio_hz, onset_s, 0.7, RATE, amplitude)
    sound += signals.white_noise(0.7, RATE, 2e-4)
    assert 0.003 < onset_lag_s(felt(sound), RATE, onset_s) < 0.012
    # The window alone is far later, so that the above can fail.
    assert onset_lag_s(felt(sound, onsets=False), RATE, onset_s) > 0.025


@pytest.mark.parametrize("audio_hz", [200.0, 700.0, 2_500.0, 7_000.0])
def test_the_window_takes_over_without_a_dip_or_a_doubling(audio_hz):
    strength, rate = signals.thinned(felt(signals.tone(audio_hz, 0.5, RATE, 0.4, 0.0)), RATE)
    strength = signals.envelope(strength, rate)[round(0.018 * rate) : round(0.4 * rate)]
    settled = strength[round(0.25 * rate) :].mean()
    # The birth's frequency is some Hz off and its level up to 2 dB: that glides within the window.
    assert strength.min() > 0.75 * settled
    assert strength.max() < 1.3 * settled


def test_a_chord_s_attack_ends_when_the_window_shows_its_tones():
    # Three tones that a window of 5 ms cannot tell from one, which the law makes 3 times weaker.
    time, over_db = signals.times(0.5, RATE), []
    for seed in range(8):
        random = np.random.default_rng(seed)
        root_hz, turns = random.uniform(100.0, 300.0), random.random(3)
        tones = np.outer([1.0, 1.26, 1.5], root_hz * time) + turns[:, None]
        vibration = felt(0.15 * np.sin(2 * np.pi * tones).sum(axis=0))
        lasting = level(vibration, 0.25, 0.4)
        over_db.append(20 * np.log10(level(vibration, 0.05, 0.08) / lasting))
    assert np.median(over_db) < 4.0


@pytest.mark.sweep
def test_noise_begins_about_as_strong_as_it_lasts():
    noises = [felt(signals.white_noise(1.0, RATE, 0.5, seed)) for seed in range(6)]
    levels = [(level(each, 0.015, 0.05), level(each, 0.3, 0.9)) for each in noises]
    first, lasting = np.mean(levels, axis=0)
    assert 0.2 * lasting < first < 3.0 * lasting


def test_a_tone_that_swells_a_little_or_goes_on_gives_birth_to_nothing():
    sound = signals.tone(440, 2.0, RATE, 0.2) * (1 + signals.tone(5, 2.0, RATE, 0.3))
    # Its phase is that of its birth, so levels are compared.
    thin = (signals.thinned(felt(sound, onsets=onsets), RATE) for onsets in (True, False))
    with_onsets, without = (signals.envelope(*each) for each in thin)
    later = slice(2_000, 5_500)
    np.testing.assert_allclose(with_onsets[later], without[later], rtol=0.0, atol=2e-3)


@pytest.mark.parametrize("rate", [8_000, 11_025, 44_100, 192_000])
def test_onsets_are_felt_as_soon_at_every_samplerate(rate):
    strength, thin = signals.thinned(felt(signals.burst(500.0, 0.2, 0.5, rate, 0.4), rate), rate)
    strength = signals.envelope(strength, thin)
    half = 0.5 * strength[round(0.3 * thin) : round(0.4 * thin)].mean()
    first_s = (strength > half).nonzero()[0][0] / thin
    assert 0.202 < first_s < 0.212


def test_onsets_made_and_planted_are_found():
    late_s, detected = onset_detection.found(*onset_detection.onset_train(60, seed=7))
    assert 2.0 * len(late_s) / (60 + detected) >= 0.95
    assert float(np.percentile(late_s, 95)) < 0.005
    backing = signals.white_noise(3.0, RATE, 0.1, 5) + signals.tone(220, 3.0, RATE, 0.1)
    sound, onsets_s = onset_detection.planted(backing, seed=8)
    late_s, detected = onset_detection.found(sound, onsets_s)
    assert len(late_s) >= 0.95 * onsets_s.size
    assert len(late_s) >= 0.9 * detected


@pytest.mark.exhaustive
def test_a_loud_sound_is_not_missed_because_a_faint_one_came_just_before():
    faint = signals.joined(signals.silence(0.25, RATE), signals.white_noise(0.25, RATE, 0.003))
    for gap_s in np.arange(0.002, 0.030, 0.002):
        loud = signals.joined(
            signals.silence(0.25 + gap_s, RATE), signals.tone(600, 0.25 - gap_s, RATE, 0.4, 0.0)
        )
        assert onset_lag_s(felt(faint + loud), RATE, 0.25 + gap_s) < 0.014


@pytest.mark.sweep
@pytest.mark.parametrize("name", list(onset_detection.steady_sounds()))
def test_steady_sounds_hold_no_onsets(name):
    sound = onset_detection.steady_sounds()[name]
    later = onset_detection.onset_times_s(sound) > onset_detection.STEADY_FROM_S
    # A level that swells from nothing 30 times a second begins as quickly as a sound does.
    assert later.sum() <= (10.0 * onset_detection.STEADY_S if "30 Hz" in name else 0.0)

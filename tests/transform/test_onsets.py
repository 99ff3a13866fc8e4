import numpy as np
import pytest

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.haptic import CoreStream
from tests.support import onset_detection, signals
from tools.bench.measures.vibration import onset_lag_s

RATE = 48_000
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

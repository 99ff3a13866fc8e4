"""Onsets: what begins is felt at once, as strong as it will be, and goes over without a seam."""

from __future__ import annotations

import numpy as np
import pytest

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.haptic import CoreStream
from tests.support import onset_detection
from tests.support.signals import burst, energy_above_db, envelope, thinned
from tools.bench.measures.vibration import onset_lag_s

RATE = 48_000
AUDIBLE_HZ = 250.0
PARAMETERS = TransformParameters()


def felt(sound: FloatArray, rate: int = RATE, onsets: bool = True) -> FloatArray:
    """Return the vibration of a mono sound, as late as it comes."""
    design = LiveDesign.of(PARAMETERS, rate, find_onsets=onsets)
    return CoreStream(design, 1, False).process(sound[:, None])[:, 0]


def level(vibration: FloatArray, at_s: float, until_s: float) -> float:
    """Return the mean of the envelope from one time to another."""
    strength, rate = thinned(vibration, RATE)
    return float(envelope(strength, rate)[round(at_s * rate) : round(until_s * rate)].mean())


def noise(frames: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, frames)


@pytest.mark.parametrize("audio_hz", [80.0, 150.0, 300.0, 1_000.0, 5_000.0])
@pytest.mark.parametrize("onset_s", [0.3, 0.3107])
def test_a_burst_out_of_a_faint_noise_is_felt_within_12_ms(audio_hz: float, onset_s: float) -> None:
    # With noise before it the burst begins anywhere in a tick: up to 2 ms later than from silence.
    frames = round(0.7 * RATE)
    since = np.arange(frames) / RATE - onset_s
    shape = np.clip(since / 0.001, 0.0, 1.0) * (since < 0.25)
    sound = 0.3 * shape * np.sin(2 * np.pi * audio_hz * since) + 2e-4 * noise(frames)
    lag_s = onset_lag_s(felt(sound), RATE, onset_s)
    assert 0.003 < lag_s < 0.012
    # The window alone is far later, so that the above can fail.
    assert onset_lag_s(felt(sound, onsets=False), RATE, onset_s) > 0.025


def test_after_a_long_silence_an_onset_is_felt_exactly_as_soon() -> None:
    sound = burst(500.0, 0.0, 0.3, RATE, 0.4)
    late = np.concatenate((np.zeros(12 * RATE + 331), sound))
    np.testing.assert_allclose(felt(late)[12 * RATE + 331 :], felt(sound), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("audio_hz", [200.0, 700.0, 2_500.0, 7_000.0])
def test_the_window_takes_over_without_a_dip_or_a_doubling(audio_hz: float) -> None:
    time = np.arange(RATE // 2) / RATE
    vibration = felt(0.4 * np.sin(2 * np.pi * audio_hz * time))
    strength, rate = thinned(vibration, RATE)
    strength = envelope(strength, rate)[round(0.018 * rate) : round(0.4 * rate)]
    settled = strength[round(0.25 * rate) :].mean()
    # The birth's frequency is some Hz off and its level up to 2 dB: that glides within the window.
    assert strength.min() > 0.75 * settled
    assert strength.max() < 1.3 * settled


def test_a_chord_s_attack_ends_when_the_window_shows_its_tones() -> None:
    # Three tones that a window of 5 ms cannot tell from one, which the law makes 3 times weaker.
    time = np.arange(RATE // 2) / RATE
    over_db = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        root_hz, turns = random.uniform(100.0, 300.0), random.random(3)
        tones = np.outer([1.0, 1.26, 1.5], root_hz * time) + turns[:, None]
        vibration = felt(0.15 * np.sin(2 * np.pi * tones).sum(axis=0))
        lasting = level(vibration, 0.25, 0.4)
        over_db.append(20 * np.log10(level(vibration, 0.05, 0.08) / lasting))
    assert np.median(over_db) < 4.0


@pytest.mark.sweep
def test_noise_begins_about_as_strong_as_it_lasts() -> None:
    levels = []
    for seed in range(6):
        sound = 0.5 * noise(RATE, seed)
        vibration = felt(sound)
        levels.append((level(vibration, 0.015, 0.05), level(vibration, 0.3, 0.9)))
    first, lasting = np.mean(levels, axis=0)
    assert 0.2 * lasting < first < 3.0 * lasting


def test_a_tone_that_swells_a_little_or_goes_on_gives_birth_to_nothing() -> None:
    time = np.arange(2 * RATE) / RATE
    sound = 0.2 * (1 + 0.3 * np.sin(2 * np.pi * 5 * time)) * np.sin(2 * np.pi * 440 * time)
    # Its phase is that of its birth, so levels are compared.
    with_onsets, without = (
        envelope(*thinned(felt(sound, onsets=onsets), RATE)) for onsets in (True, False)
    )
    later = slice(2_000, 5_500)
    np.testing.assert_allclose(with_onsets[later], without[later], rtol=0.0, atol=2e-3)


@pytest.mark.parametrize("rate", [8_000, 11_025, 44_100, 192_000])
def test_onsets_are_felt_as_soon_at_every_samplerate(rate: int) -> None:
    sound = burst(500.0, 0.0, 0.3, rate, 0.4)
    strength, thin = thinned(felt(np.concatenate((np.zeros(rate // 5), sound)), rate), rate)
    strength = envelope(strength, thin)
    half = 0.5 * strength[round(0.3 * thin) : round(0.4 * thin)].mean()
    first_s = (strength > half).nonzero()[0][0] / thin
    assert 0.202 < first_s < 0.212


@pytest.mark.parametrize("kind", ["step", "sample", "square", "NaN", "denormal"])
def test_hard_sounds_stay_bounded_inaudible_and_come_to_rest(kind: str) -> None:
    sound = np.zeros(2 * RATE)
    body = sound[RATE // 4 : RATE // 2]
    if kind == "step":
        body[:] = 0.8
    elif kind == "sample":
        body[0] = 1.0
    elif kind == "square":
        body[:] = np.sign(np.sin(2 * np.pi * 100 * np.arange(body.size) / RATE) + 1e-9)
    elif kind == "NaN":
        body[::3], body[1::7] = np.nan, np.inf
    else:
        body[:] = 1e-310
    vibration = felt(sound)
    assert np.abs(vibration).max() < 1.0
    assert not vibration[-RATE // 4 :].any()
    if kind in ("NaN", "denormal"):
        assert not vibration.any()
    else:
        assert energy_above_db(vibration, AUDIBLE_HZ, RATE) < -50.0


def test_streams_shorter_than_a_tick_or_of_single_frames_are_taken() -> None:
    for frames in (0, 1, 50, 300):
        assert felt(0.5 * noise(frames)).shape == (frames,)
    sound = burst(300.0, 0.0, 0.02, RATE, 0.5)[:2_000]
    design = LiveDesign.of(PARAMETERS, RATE)
    stream = CoreStream(design, 1, False)
    single = [stream.process(sound[at : at + 1, None]) for at in range(sound.size)]
    assert np.concatenate(single)[:, 0].tobytes() == felt(sound).tobytes()


def test_onsets_made_and_planted_are_found() -> None:
    made = onset_detection.found(*onset_detection.onset_train(60, seed=7))
    assert made.f1 >= 0.95
    assert float(np.percentile(made.late_s, 95)) < 0.005
    backing = 0.1 * noise(3 * RATE, 5) + 0.1 * np.sin(2 * np.pi * 220 * np.arange(3 * RATE) / RATE)
    planted = onset_detection.found(*onset_detection.planted(backing, seed=8))
    assert planted.recall >= 0.95
    assert planted.precision >= 0.9


@pytest.mark.exhaustive
def test_a_loud_sound_is_not_missed_because_a_faint_one_came_just_before() -> None:
    found = 0
    for gap_ms in range(2, 30, 2):
        sound = np.zeros(RATE // 2)
        faint, loud = RATE // 4, RATE // 4 + gap_ms * RATE // 1_000
        sound[faint:] += 0.003 * noise(sound.size - faint, gap_ms)
        time = np.arange(sound.size - loud) / RATE
        sound[loud:] += 0.4 * np.sin(2 * np.pi * 600 * time)
        vibration = felt(sound)
        found += onset_lag_s(vibration, RATE, loud / RATE) < 0.014
    assert found == 14


@pytest.mark.sweep
@pytest.mark.parametrize("name", list(onset_detection.steady_sounds()))
def test_steady_sounds_hold_no_onsets(name: str) -> None:
    sound = onset_detection.steady_sounds()[name]
    later = onset_detection.onset_times_s(sound) > onset_detection.STEADY_FROM_S
    # A level that swells from nothing 30 times a second begins as quickly as a sound does.
    assert later.sum() <= (10.0 * onset_detection.STEADY_S if "30 Hz" in name else 0.0)


def test_the_delay_that_is_declared_is_made_of_its_parts() -> None:
    design = LiveDesign.of(PARAMETERS, RATE)
    smoothing = design.synthesis.delay_s(60.0, RATE) * RATE
    assert design.latency_frames == round(2.1 * design.grid.tick_frames + smoothing)
    assert design.latency_frames < design.tonal_latency_frames
    without = LiveDesign.of(PARAMETERS, RATE, find_onsets=False)
    assert without.latency_frames == design.tonal_latency_frames

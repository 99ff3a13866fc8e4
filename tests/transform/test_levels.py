import numpy as np
import pytest

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.mapping import VibrationMapping, vibration_hz
from tests.support import signals

RATE = 48_000
PAPER = TransformParameters()
ENERGY = TransformParameters(amplitude_mapping="energy")
JND = TransformParameters(mapping="jnd")
FULL_SCALE_R = PAPER.unit_strength_hz(RATE)


@pytest.mark.parametrize("amplitude", [0.02, 0.3, 1.0])
def test_a_steady_tone_is_as_strong_as_it_is_and_two_share_only_the_paper_s_law(amplitude):
    tonal, energy = (VibrationMapping.of(each, FULL_SCALE_R) for each in (PAPER, ENERGY))
    for tones in (1, 2):
        height = np.full(tones, amplitude)
        assert energy.amplitudes(height, height * FULL_SCALE_R) == pytest.approx(height)
        assert tonal.amplitudes(height, height * FULL_SCALE_R) == pytest.approx(height / tones)


def test_by_energy_power_follows_height_squared_times_width():
    rng = np.random.default_rng(3)
    height, width = rng.uniform(0.01, 1, 20), rng.uniform(20, 200, 20)
    level = VibrationMapping.of(ENERGY, FULL_SCALE_R).amplitudes(height, height * width)
    assert level**2 == pytest.approx(height**2 * width / FULL_SCALE_R)


def by_either_law(sound, form):
    both = (signals.played(sound, RATE, form=form, parameters=law) for law in (PAPER, ENERGY))
    return (each[:, 0] for each in both)


@pytest.mark.parametrize("form", signals.FORMS)
def test_by_energy_a_tone_is_the_same_noise_stronger_and_one_sample_a_faint_thump(form):
    middle = slice(RATE // 4, 3 * RATE // 4)
    tonal, energy = by_either_law(signals.tone(440, 1.0, RATE, 0.5), form)
    # The tone's r is read off a bell or a line between bins: within 1.4 %, and its root here.
    level_db, wanted_db = (signals.level_db(each[middle]) for each in (energy, tonal))
    assert level_db == pytest.approx(wanted_db, abs=0.1)
    tonal, energy = by_either_law(signals.white_noise(2.0, RATE, 0.5), form)
    assert signals.level_db(energy) > signals.level_db(tonal) + 6.0
    assert np.abs(energy).max() < 1.0
    tonal, energy = by_either_law(signals.one_sample(0.6, RATE, 0.3), form)
    # Its onset is felt before it is known that nothing follows: 18 dB weaker, without that 24.
    assert 0.0 < np.abs(energy).max() < np.abs(tonal).max() / 6


def test_with_equal_jnds_every_octave_of_sound_is_the_same_ratio_of_vibration():
    octaves = 50.0 * np.exp2(np.arange(8.0))
    felt = vibration_hz(octaves, JND)
    assert felt[0] == pytest.approx(PAPER.vibration_bottom_hz)
    assert vibration_hz(np.array(12_000.0), JND) == pytest.approx(220.0)
    assert felt[1:] / felt[:-1] == pytest.approx(np.full(7, 2.0**JND.scale_ratio))
    steps = np.diff(vibration_hz(octaves, PAPER))
    assert steps == pytest.approx(np.full(7, PAPER.scale_hz * np.log(2)))


@pytest.mark.parametrize("parameters", [PAPER, JND], ids=["paper", "jnd"])
def test_the_slope_is_that_of_the_mapping(parameters):
    audio_hz, mapping = np.geomspace(60, 10_000, 30), VibrationMapping.of(parameters)
    a, b = mapping.scale_hz, mapping.scale_ratio
    up, down = (vibration_hz(audio_hz * step, parameters) for step in (1 + 1e-6, 1 - 1e-6))
    assert (up - down) / 2e-6 == pytest.approx(a + b * vibration_hz(audio_hz, parameters), rel=1e-6)


@pytest.mark.parametrize("audio_hz", [200.0, 1_000.0, 4_000.0])
def test_a_tone_is_felt_where_its_mapping_says(audio_hz):
    vibration = signals.played(signals.tone(audio_hz, 2.0, RATE, 0.5), RATE, parameters=JND)[:, 0]
    steady, rate = signals.thinned(vibration[RATE // 2 : 3 * RATE // 2], RATE)
    wanted = float(vibration_hz(np.array(audio_hz), JND))
    hz, amplitude, residual_db = signals.best_sinusoid(steady, rate, wanted)
    assert hz == pytest.approx(wanted, abs=0.1)
    assert amplitude == pytest.approx(0.5, rel=0.06)
    assert residual_db < -50

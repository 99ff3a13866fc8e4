import numpy as np
import pytest

from audioflinger_hook.baselines import centroid, envelope, octave_fold
from tests.support.signals import level_db
from tools.bench.baselines import BASELINES
from tools.bench.measures.vibration import sine_fit
from tools.bench.sounds.signals import SAMPLERATE, tone, white_noise

SUBJECTS = {subject.name: subject for subject in BASELINES}
OTHER_RATES = (pytest.param(hz, marks=pytest.mark.exhaustive) for hz in (8_000, 44_100, 192_000))
RATES = (48_000, *OTHER_RATES)


def felt(name, frequency_hz, amplitude=0.3, samplerate=SAMPLERATE):
    """The settled second half of a second of a tone's vibration."""
    sound = tone(frequency_hz, amplitude, 1.0, samplerate)
    return SUBJECTS[name].vibration(sound, samplerate)[samplerate // 2 :]


EVERY = pytest.mark.parametrize("name", list(SUBJECTS))


@EVERY
@pytest.mark.parametrize("samplerate", RATES)
def test_silence_gives_silence(name, samplerate):
    assert not SUBJECTS[name].vibration(np.zeros(samplerate), samplerate).any()


@EVERY
def test_blocks_of_any_size_give_the_same_vibration_of_numbers_alone(name):
    sound = white_noise(0.4)
    sound[1_000], sound[2_000], sound[3_000] = np.nan, np.inf, 1e9
    whole, cut = (SUBJECTS[name].start(SAMPLERATE, 2) for _ in range(2))
    expected = np.concatenate((whole.process(sound), whole.finish()))
    assert np.isfinite(expected).all()
    assert expected.any()
    parts = [cut.process(part) for part in np.split(sound, [1, 8, 250, 1_234, 9_000])]
    # sums in another order: rounding, no more
    np.testing.assert_allclose(np.concatenate([*parts, cut.finish()]), expected, atol=1e-9)


def test_the_band_pass_passes_100_hz_and_stops_2_khz():
    passed_db = level_db(felt("band-pass", 100.0))
    assert passed_db == pytest.approx(level_db(tone(100.0, 0.3, 1.0)), abs=0.5)
    # two poles above 250 Hz: 12 dB an octave over three octaves
    assert level_db(felt("band-pass", 2_000.0)) < passed_db - 34.0


def test_the_envelope_of_a_sound_is_felt_and_its_levelling_outweighs_its_expansion():
    swelling = tone(3_000.0, 0.3, 1.0) * (tone(150.0, 0.5, 1.0) + 0.5)
    vibration = SUBJECTS["envelope"].vibration(swelling, SAMPLERATE)[SAMPLERATE // 2 :]
    assert sine_fit(vibration, SAMPLERATE).frequency_hz == pytest.approx(150.0, abs=0.5)
    assert level_db(vibration) > level_db(felt("envelope", 3_000.0)) + 20.0
    loud, quiet = (felt("envelope", 150.0, amplitude) for amplitude in (0.5, 0.05))
    assert np.abs(loud).max() < envelope.GAIN_OUT
    # the cube alone would make 60 dB of 20
    assert 0.0 < level_db(loud) - level_db(quiet) < 20.0


@pytest.mark.parametrize("frequency_hz", [100.0, 300.0, 500.0])
def test_the_centroid_follows_a_tone(frequency_hz):
    fit = sine_fit(felt("centroid", frequency_hz), SAMPLERATE)
    # bins are 47 Hz wide, and a window's main lobe is cut off at the band's ends
    assert fit.frequency_hz == pytest.approx(frequency_hz, abs=15.0)
    assert fit.amplitude == pytest.approx(0.3, rel=0.1)


def test_the_centroid_s_envelope_falls_by_e_in_a_tenth_of_a_second():
    way = centroid.Method(SAMPLERATE, 1)
    sound = np.zeros((SAMPLERATE // way.hop, way.hop))
    sound[0] = 0.5
    level, at = way._envelope(sound), round((0.1 + centroid.HOLD_S) * SAMPLERATE / way.hop)
    assert level[0] == pytest.approx(0.5)
    assert level[at] == pytest.approx(0.5 / np.e, rel=0.04)  # within a hop, 2.7 ms


@pytest.mark.parametrize(
    ("frequency_hz", "folded_hz"), [(1_000.0, 125.0), (600.0, 150.0), (3_500.0, 218.75)]
)
def test_the_fold_brings_a_tone_under_230_hz_by_octaves(frequency_hz, folded_hz):
    fit = sine_fit(felt("octave fold", frequency_hz), SAMPLERATE)
    assert fit.frequency_hz < octave_fold.UNDER_HZ
    assert fit.frequency_hz == pytest.approx(folded_hz, rel=0.01)
    for outside_hz in (100.0, 8_000.0):  # of its ranges
        assert level_db(felt("octave fold", outside_hz)) < -60.0

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tools.bench.measures import loudness
from tools.bench.measures.felt import felt_db, running_db, seat_weight, weighted
from tools.bench.measures.impacts import attack, is_impact
from tools.bench.measures.loudness import FULL_SCALE_PA, loudness_sone, n5_phon, phon, slow_phon
from tools.bench.measures.steadiness import rises_of_its_own, rises_s, syllables_alike, warble
from tools.bench.sounds.signals import SAMPLERATE, tone

TIME_S = np.arange(2 * SAMPLERATE) / SAMPLERATE


def struck(at_s, decay_s=0.03, rise_s=0.002, frequency_hz=180.0):
    since_s = TIME_S - at_s
    rise = np.clip(since_s / rise_s, 0.0, 1.0)
    fall = np.exp(-np.maximum(since_s, 0.0) / decay_s)
    return 0.5 * rise * fall * np.sin(2.0 * np.pi * frequency_hz * since_s)


def modulated(depth, rate_hz):
    return (1.0 + depth * np.sin(2.0 * np.pi * rate_hz * TIME_S)) * tone(80.0, 0.3, 2.0)


def beats_a_second(rate_hz):
    return tone(200.0, 0.5, 2.0) * (TIME_S * rate_hz % 1.0 >= 0.5)


def test_the_weight_is_that_of_the_standard_where_its_band_limit_does_nothing():
    # ISO 2631-1:1997, table 3, Wk.
    wanted = {4.0: 0.967, 8.0: 1.036, 12.5: 0.902, 16.0: 0.768, 20.0: 0.636, 31.5: 0.405}
    assert seat_weight(np.array([*wanted])) == pytest.approx([*wanted.values()], rel=0.01)


@given(st.floats(40.0, 250.0))
def test_above_40_hz_equal_velocity_is_felt_equally(vibration_hz):
    one, other = seat_weight(np.array([40.0, vibration_hz]))
    assert other * vibration_hz == pytest.approx(one * 40.0, rel=0.05)


@pytest.mark.parametrize("vibration_hz", [20.0, 50.0, 150.0])
def test_a_steady_tone_is_felt_at_its_weighted_level(vibration_hz):
    felt = felt_db(running_db(weighted(tone(vibration_hz, 0.5, 2.0), SAMPLERATE), SAMPLERATE))
    weight = float(seat_weight(np.array(vibration_hz)))
    assert felt == pytest.approx(20.0 * np.log10(0.5 * weight), abs=0.3)


def test_a_tone_of_a_sixteenth_of_a_second_is_felt_less_than_a_long_one_and_more_than_silence():
    long = tone(100.0, 0.5, 1.0)
    short = np.where(np.arange(SAMPLERATE) < SAMPLERATE // 16, long, 0.0)
    felt = [felt_db(running_db(each, SAMPLERATE)) for each in (short, long, 0.0 * long)]
    assert felt[1] - 6.0 < felt[0] < felt[1] - 2.0
    assert felt[2] == -70.0


@settings(deadline=None, max_examples=10)
@given(st.floats(0.0, 0.05))
def test_a_vibration_that_is_only_late_has_that_lag(delay_s):
    found = attack(struck(0.5), 0.3 * struck(0.5 + delay_s), SAMPLERATE, 0.4)
    assert found is not None
    assert found.half_lag_s == pytest.approx(delay_s, abs=1e-3)
    assert found.peak_lag_s == pytest.approx(delay_s, abs=1e-3)


def test_a_second_stroke_of_twice_the_strength_is_the_peak_and_none_is_felt_under_a_steady_one():
    found = attack(struck(0.5), 0.4 * struck(0.5) + struck(0.56), SAMPLERATE, 0.4)
    assert found is not None
    assert found.half_lag_s > 0.04
    assert found.peak_lag_s == pytest.approx(0.06, abs=5e-3)
    sound = struck(0.5)
    assert attack(sound, np.zeros(sound.size), SAMPLERATE, 0.4) is None
    assert attack(sound, tone(100.0, 0.3, 2.0), SAMPLERATE, 0.4) is None


def test_an_impact_begins_suddenly_and_a_brief_one_is_over_soon():
    slow, long = struck(0.1, decay_s=1.0, rise_s=0.3), struck(0.1, decay_s=1.0)
    again = struck(0.1) + 2.0 * struck(1.0)
    sounds = (struck(0.1), long, slow, again)
    sudden, brief = (
        [is_impact(sound, SAMPLERATE, brief=brief) for sound in sounds] for brief in (False, True)
    )
    assert (sudden, brief) == ([True, True, False, True], [True, False, False, False])


@settings(deadline=None, max_examples=10)
@given(st.floats(0.05, 0.9), st.floats(6.0, 12.0))
def test_warble_is_the_depth_of_modulation(depth, rate_hz):
    assert warble(modulated(depth, rate_hz), SAMPLERATE) == pytest.approx(depth, rel=0.1)


def test_steady_slow_and_silent_vibration_does_not_warble():
    assert warble(tone(80.0, 0.3, 2.0), SAMPLERATE) < 0.02
    assert warble(modulated(0.5, 0.5), SAMPLERATE) < 0.1
    assert warble(np.zeros(SAMPLERATE), SAMPLERATE) == 0.0


@pytest.mark.parametrize("rate_hz", [2.0, 4.0, 7.0])
def test_a_tone_that_comes_again_and_again_rises_each_time(rate_hz):
    rises = rises_s(beats_a_second(rate_hz), SAMPLERATE)
    assert abs(rises.size - 2.0 * rate_hz) <= 1
    assert np.diff(rises) == pytest.approx(1.0 / rate_hz, abs=0.02)
    assert rises_s(modulated(0.3, rate_hz), SAMPLERATE).size == 0  # less than 6 dB do not count


def test_only_rises_without_one_in_the_sound_are_a_vibrations_own():
    sound, steady = beats_a_second(4.0), tone(200.0, 0.5, 2.0)
    assert rises_of_its_own(sound, np.roll(sound, SAMPLERATE // 50), SAMPLERATE) == 0.0
    assert rises_of_its_own(steady, sound, SAMPLERATE) == pytest.approx(4.0, abs=0.5)
    assert rises_of_its_own(sound, steady, SAMPLERATE) == 0.0


@pytest.mark.parametrize("late_s", [0.0, 0.04])
def test_syllables_are_alike_where_the_envelope_is_at_any_delay_up_to_80_ms(late_s):
    words = sum(struck(at, decay_s=0.08, frequency_hz=900.0) for at in (0.2, 0.45, 0.9, 1.3))
    felt = sum(struck(at + late_s, decay_s=0.08, frequency_hz=80.0) for at in (0.2, 0.45, 0.9, 1.3))
    assert syllables_alike(words, felt, SAMPLERATE) > 0.97
    assert syllables_alike(words, tone(80.0, 0.3, 2.0), SAMPLERATE) < 0.5


mosqito = pytest.importorskip("mosqito.sq_metrics")


def at_spl(frequency_hz, level_db, duration_s=0.6):
    """A sine of that sound pressure level, where a full-scale one has 94 dB."""
    return tone(frequency_hz, 10.0 ** ((level_db - 94.0) / 20.0), duration_s)


def pulse(duration_s):
    """A 1 kHz tone pulse of 70 dB, as the standard's test signals 10 to 12."""
    return np.concatenate((np.zeros(2_400), at_spl(1_000.0, 70.0, duration_s), np.zeros(12_000)))


# ISO 532-1:2017, annex B: test signals 2 to 4, and the definition of the sone.
@pytest.mark.parametrize(
    ("frequency_hz", "level_db", "sone"),
    [(1_000.0, 40.0, 1.0), (250.0, 80.0, 14.655), (1_000.0, 60.0, 4.019), (4_000.0, 40.0, 1.549)],
)
def test_steady_tones_have_the_standard_s_loudness_within_one_percent(frequency_hz, level_db, sone):
    settled = loudness_sone(at_spl(frequency_hz, level_db))[-200:]
    assert settled == pytest.approx(sone, rel=0.01)
    if frequency_hz == 1_000.0:
        assert phon(settled) == pytest.approx(level_db, abs=0.5)


@pytest.mark.parametrize("duration_s", [0.01, 0.05])
def test_the_coarser_decay_gives_pulses_the_loudness_of_the_whole_procedure(duration_s):
    signal = pulse(duration_s)
    whole = mosqito.loudness_zwtv(FULL_SCALE_PA * signal, SAMPLERATE)[0]
    ours = loudness_sone(signal)
    for measure in (np.max, lambda sone: np.percentile(sone, 95.0)):
        assert measure(ours) == pytest.approx(measure(whole), rel=0.02)


def test_loudness_over_time_follows_the_level_of_pieces():
    quiet, loud = at_spl(1_000.0, 50.0, 0.5), at_spl(1_000.0, 70.0, 0.5)
    levels = slow_phon(np.concatenate((quiet, loud)), 0.25)
    assert (levels.shape, levels[1]) == ((4,), pytest.approx(50.0, abs=0.5))
    assert levels[3] == pytest.approx(70.0, abs=0.5)


def test_what_was_computed_is_read_from_the_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(loudness, "CACHE", tmp_path / "cache" / "loudness.json")
    monkeypatch.setattr(loudness, "_memory", {})
    signal = pulse(0.02)
    first = n5_phon(signal, 0.1)
    monkeypatch.setattr(loudness, "_memory", {})
    monkeypatch.setattr(loudness, "loudness_sone", lambda _: pytest.fail("computed again"))
    assert n5_phon(signal, 0.1) == first

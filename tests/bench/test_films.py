from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.baselines import centroid, envelope, octave_fold
from audioflinger_hook.transform import TransformParameters
from device.rig.rig import SHIPPED
from tests.support.signals import level_db
from tools.bench.baselines import BASELINES
from tools.bench.measures import contrasts as seen
from tools.bench.measures.classes import features, told_apart
from tools.bench.measures.contrasts import added_db, levels_db, loud_db, standing_out
from tools.bench.measures.loudness import STEP_S, loudness_sone
from tools.bench.measures.match import PIECE_S, match, pieces_rms
from tools.bench.measures.vibration import energy_under_db, sine_fit, steady_fit
from tools.bench.methods import Method
from tools.bench.sections import felt_films, felt_singles
from tools.bench.sections.felt_films import Contrasts, contrasts, heard_contrasts, missed
from tools.bench.sections.felt_rigs import over_dialogue
from tools.bench.sounds.films import LAYOUTS, Film, film, from_onset, going_on, impacts_over_music
from tools.bench.sounds.real_sounds import KINDS, RealSound
from tools.bench.sounds.signals import SAMPLERATE, pink_noise, tone, white_noise

SECOND = SAMPLERATE


def made_sounds(a_class=3):
    rng, found = np.random.default_rng(3), []
    for kind in KINDS:
        for number in range(a_class):
            sound = 0.3 * rng.standard_normal((1 + number) * SECOND)
            if kind in ("explosions", "shots", "drums"):
                sound *= np.exp(-np.arange(sound.size) / 4_000.0)
            found.append(RealSound(f"{kind}/{number}", kind, sound))
    return found


SOUNDS = made_sounds()


@pytest.fixture(scope="module", params=LAYOUTS)
def made_film(request):
    return film(request.param, SOUNDS, 1)


def test_a_film_is_made_by_its_seed_of_parts_that_follow_one_another(made_film):
    again, other = (film(made_film.kind, SOUNDS, seed) for seed in (1, 2))
    assert again.sound.tobytes() == made_film.sound.tobytes()
    assert other.sound.tobytes() != made_film.sound.tobytes()
    assert np.abs(made_film.sound).max() <= 1.0
    names = ("dialogue", "quiet", "action", "hiss", "again")
    parts = [getattr(made_film, name) for name in names]
    assert parts[0].start == 0
    assert all(one.stop == after.start for one, after in pairwise(parts))
    strokes = np.array(made_film.strokes)
    assert strokes.size == 8
    assert made_film.action.start < strokes.min() < strokes.max() < made_film.action.stop
    assert np.diff(strokes).min() > 3 * SECOND
    hiss = made_film.sound[made_film.hiss]
    assert (hiss.size, 20.0 * np.log10(hiss.std())) == (30 * SECOND, pytest.approx(-70.0, abs=3.0))
    # The last words before the action are the first after the hiss, which lies 45 dB under them.
    one, other = (made_film.sound[place] for place in (made_film.word, made_film.again))
    assert made_film.word.stop == made_film.dialogue.stop
    assert np.corrcoef(one, other)[0, 1] > 0.999
    own = heard_contrasts(made_film)
    assert (own.over > 5.0, own.quiet > 15.0, own.hiss < -40.0) == (True, True, True)
    assert abs(own.word) < 0.5


@given(st.integers(1, 4 * SECOND), st.integers(2, SECOND))
@settings(max_examples=20, deadline=None)
def test_a_sound_goes_on_for_as_long_as_wanted_at_its_level(frames, length):
    played = going_on(0.1 * np.random.default_rng(1).standard_normal(length), frames, -20.0)
    assert played.size == frames
    if frames > 1:
        assert 20.0 * np.log10(float(played.std())) == pytest.approx(-20.0, abs=1e-6)


def test_impacts_over_music_differ_from_the_music_only_after_their_onset():
    mixes = impacts_over_music(SOUNDS, 2)
    assert len(mixes) == 2 * 9
    for each in mixes:
        assert np.array_equal(each.sound[: each.at], each.music[: each.at])
        assert np.abs(each.sound - each.music).max() == pytest.approx(10 ** (-3 / 20), rel=0.2)
        assert each.music.std() == pytest.approx(10 ** (-18 / 20), rel=1e-6)


def test_levels_are_of_a_sines_peak_and_of_what_is_heard_or_felt_of_it():
    assert levels_db(tone(100.0, 1.0, 1.0), SAMPLERATE)[200:] == pytest.approx(0.0, abs=0.02)
    assert levels_db(np.zeros(SECOND), SAMPLERATE) == pytest.approx(-70.0)  # nothing is felt
    deep, high = (loud_db(seen.heard_db(tone(hz, 0.5, 2.0), SAMPLERATE)) for hz in (20.0, 500.0))
    assert high == pytest.approx(-6.0, abs=0.1)
    assert deep < high - 20.0
    one, other = (
        loud_db(seen.felt_levels_db(tone(hz, 0.5, 2.0), SAMPLERATE)) for hz in (60.0, 120.0)
    )
    assert one - other == pytest.approx(6.0, abs=0.3)  # an octave


def test_strokes_stand_out_if_their_rise_is_larger_than_most_and_are_as_strong_as_their_peak():
    levels = -30.0 + np.random.default_rng(2).uniform(0.0, 5.0, 20_000)
    strokes = np.arange(2_000.0, 20_000.0, 4_000.0)
    for at in strokes.astype(int):
        levels[at] = -30.0
        levels[at + 50 : at + 250] += 12.0
    assert standing_out(levels, strokes) == 100.0
    assert standing_out(np.full(20_000, -30.0), strokes) == 0.0
    levels = np.full(3_000, -30.0)
    levels[1_200], levels[1_800] = -10.0, 0.0
    assert seen.strokes_db(levels, np.array([1_000.0])) == pytest.approx([-10.0])


@given(st.lists(st.floats(-70.0, 0.0), min_size=300, max_size=600))
@settings(max_examples=20)
def test_a_rise_goes_to_the_highest_level_of_the_next_quarter_of_a_second(levels):
    found = seen.rises_db(np.array(levels))
    assert found.size == len(levels) - 250
    quarters = (levels[at : at + 251] for at in range(len(levels) - 250))
    assert found.tolist() == [max(quarter) - quarter[0] for quarter in quarters]


def test_what_a_stroke_adds_is_the_ratio_of_energies_after_it():
    music = tone(200.0, 0.1, 2.0)
    both = music.copy()
    both[SECOND:] *= 2.0
    assert added_db(both, music, SAMPLERATE, SECOND) == pytest.approx(6.02, abs=0.05)
    assert added_db(music, music, SAMPLERATE, SECOND) == 0.0


def test_the_contrasts_of_a_film_are_those_of_its_levels(made_film):
    levels = np.full(made_film.sound.size // 48, -40.0)
    for part, level in (("action", -20.0), ("hiss", -60.0), ("word", -38.0), ("again", -33.0)):
        place = getattr(made_film, part)
        levels[place.start // 48 : place.stop // 48] = level
    found = contrasts(levels, made_film)
    dialogue = loud_db(levels[: made_film.dialogue.stop // 48])
    assert found.over == pytest.approx(-20.0 - dialogue)
    assert found.quiet == pytest.approx(20.0)
    assert found.hiss == pytest.approx(-60.0 - dialogue)
    assert found.word == pytest.approx(5.0)
    assert found.out == 0.0


def test_a_film_misses_what_is_under_two_thirds_of_a_limit():
    own = Contrasts(over=9.0, quiet=27.0, out=75.0, hiss=-50.0, word=0.0)
    assert missed(own, own) == []
    every = ["over", "quiet", "out", "hiss", "word"]
    assert missed(Contrasts(3.5, 8.0, 39.0, -6.0, 6.5), own) == every
    assert missed(Contrasts(3.7, 8.2, 41.0, -7.0, 5.9), own) == []


@given(st.floats(0.01, 100.0), st.integers(0, 4))
def test_vibration_in_proportion_to_loudness_matches_at_any_gain_up_to_80_ms_before(gain, late):
    rms = 1.0 + np.sin(np.arange(100) / 7.0)
    sone = np.concatenate((np.full(late, 0.5), rms))[: rms.size]
    assert match(sone, gain * rms) == pytest.approx(100.0, abs=1e-6)


def test_a_late_or_constant_vibration_does_not_match_a_sound_that_changes():
    sone = 1.0 + np.sin(np.arange(100) / 2.0)
    assert match(sone, np.roll(sone, 2)) < 80.0
    constant = np.full(100, 0.3)
    assert match(np.full(100, 4.0), constant) == 100.0
    assert match(np.tile((0.0, 8.0), 50), constant) == 0.0
    assert pieces_rms(np.ones(SECOND), SAMPLERATE) == pytest.approx(np.ones(50))  # of 20 ms


@pytest.mark.parametrize("onset_s", [0.3, 0.35])
def test_the_soft_power_of_a_sounds_own_strength_matches_its_momentary_loudness(onset_s):
    pytest.importorskip("mosqito")
    sound = 0.3 * np.random.default_rng(1).standard_normal(SECOND)
    at = round(onset_s * SECOND)
    sound[:at] = 0.0
    sound[at:] *= np.exp(-np.arange(SECOND - at) / 6_000.0)
    steps, sone = round(PIECE_S / STEP_S), loudness_sone(sound)
    sone = sone[: sone.size // steps * steps].reshape(-1, steps).mean(axis=1)
    # In time with the sound: its amplitude to the power that loudness follows.
    assert match(sone, pieces_rms(sound, SAMPLERATE) ** 0.6) > 90.0


def test_classes_that_differ_in_strength_are_told_apart_and_equal_ones_are_not():
    rng = np.random.default_rng(5)
    gains = np.repeat((0.01, 0.5), 8) * rng.uniform(0.9, 1.1, 16)
    found = np.array([features(tone(80.0, gain, 1.0), SAMPLERATE) for gain in gains])
    kinds = ["weak"] * 8 + ["strong"] * 8
    assert told_apart(found, kinds) == 100.0
    assert told_apart(np.zeros((16, 6)), kinds) <= 50.0


def test_features_of_a_steady_tone_have_no_spread_and_its_frequency_as_centroid():
    level, spread, moved, centroid, wide, glide = features(tone(80.0, 1.0, 1.0), SAMPLERATE)
    assert (level, centroid) == (pytest.approx(-3.01, abs=0.01), pytest.approx(80.0, abs=1.0))
    assert max(spread, moved) < 0.01
    assert max(wide, glide) < 1.0
    assert not features(np.zeros(SECOND), SAMPLERATE).any()


def test_a_tone_whose_level_drifts_slowly_has_no_distortion_and_one_that_warbles_has():
    time_s, sine = np.arange(3 * SECOND) / SECOND, tone(90.0, 0.3, 3.0)
    assert steady_fit(sine * (1.0 + 0.1 * time_s), SAMPLERATE) < -100.0
    warbling = steady_fit(sine * (1.0 + 0.02 * np.sin(2 * np.pi * 6.0 * time_s)), SAMPLERATE)
    # Two side bands of a hundredth each.
    assert warbling == pytest.approx(-37.0, abs=0.3)


def test_onset_and_loudest_moment_are_found_and_a_first_step_is_a_share_of_the_peak():
    sound = np.concatenate((np.zeros(SECOND), tone(300.0, 0.5, 1.0)))
    assert from_onset(sound).size == SECOND - 1  # the tone is silent at its first sample
    sound = np.interp(np.arange(1_500), (100, 600, 1_500), (0.0, 1.0, 0.0))
    assert felt_singles.from_loudest(sound)[0] == pytest.approx(1.0, abs=0.01)
    assert felt_singles.step_share(np.array([0.1, -0.4, 0.2])) == pytest.approx(0.25)
    assert felt_singles.step_share(np.zeros(10)) == 0.0


def test_pink_noise_has_as_much_energy_in_every_octave_and_a_corner_what_lies_under_it():
    spectrum = np.abs(np.fft.rfft(pink_noise(8 * SECOND, np.random.default_rng(1)))) ** 2
    hz = np.fft.rfftfreq(8 * SECOND, 1 / SECOND)
    octaves = [spectrum[(hz >= low) & (hz < 2 * low)].sum() for low in (100, 400, 1_600, 6_400)]
    assert 10 * np.log10(np.array(octaves) / octaves[0]) == pytest.approx(0.0, abs=1.0)
    slow, fast = tone(5.0, 0.1, 4.0), tone(80.0, 1.0, 4.0)
    assert energy_under_db(slow + fast, SAMPLERATE, 15.0) == pytest.approx(-20.0, abs=0.2)


def test_the_sound_has_a_column_of_its_own_on_films_and_on_impacts():
    series: felt_films.Series = {}
    rows = list(felt_films.film_rows([], [film("film", SOUNDS, 0)], series))
    assert ({row.column for row in rows}, len(series["film, sound"])) == ({"sound"}, 1_060)
    rows = list(felt_films.over_music_rows([], impacts_over_music(SOUNDS, 1)))
    assert [row.column for row in rows] == ["sound"]
    assert (rows[0].value or 0.0) > 80.0


@pytest.mark.parametrize("rig", SHIPPED)
def test_a_rigs_seat_moves_more_for_a_stroke_that_is_stronger(rig):
    tonal = TransformParameters(strength="flat")
    said, action = slice(0, 2 * SECOND), slice(2 * SECOND, 4 * SECOND)
    # An onset may add to the stroke's 12 dB.
    for gain, wanted in ((1.0, pytest.approx(0.0, abs=1.5)), (4.0, pytest.approx(12.0, abs=3.0))):
        sound = tone(60.0, 0.05, 4.0)
        sound[3 * SECOND : 3 * SECOND + SECOND // 4] *= gain
        film = Film("film", sound, said, said, action, action, (3 * SECOND,), action, action)
        assert over_dialogue(film, rig, "off", tonal) == wanted


def test_floors_are_asked_only_over_both_halves_of_the_sounds(monkeypatch):
    loudness = np.abs(np.sin(np.arange(50) / 5.0))
    monkeypatch.setattr(felt_singles, "momentary_sone", lambda *_: loudness)
    cinema = Method("cinema", lambda sound, _rate: sound, limited=True)
    some = [one for one in made_sounds(2) if one.kind in ("speech", "explosions")]
    for half, asked in ((some[:2], True), (some, False)):
        rows = {row.name: row for row in felt_singles.single_rows([cinema], some, half)}
        assert bool(rows["match, mean"].must) == asked
        assert bool(rows["6 classes told apart"].must) == asked
        assert rows["match under 70"].must
        assert ("match under 70, reported half" in rows) == asked


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

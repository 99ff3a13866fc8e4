from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.mapping import VibrationMapping, vibration_hz
from audioflinger_hook.transform.reference import ReferenceTransform, Superposition
from tests.support import signals
from tests.support.recordings import require_recordings
from tests.support.reference_oracle import oracle_units, oracle_vibration

AGREEMENT = 1e-5
"""Of full scale; what two implementations of the same equations owe each other."""

UNITS_AGREEING = 0.99
"""In the rest two candidates may tie within rounding."""

PARAMETERS = TransformParameters()

OTHER_PARAMETERS = {
    "a short window": TransformParameters(window_s=0.02, vibration_top_hz=200.0),
    "a long window": TransformParameters(window_s=0.1),
    "a narrow band": TransformParameters(band_low_hz=200.0, band_high_hz=2_000.0),
    "a low top": TransformParameters(vibration_top_hz=90.0),
    "a low threshold and few partials": TransformParameters(threshold_hz=0.02, partials_max=3),
    "one partial": TransformParameters(partials_max=1),
}


def disagreement(sound, samplerate, parameters=PARAMETERS):
    """Return the largest difference from the oracle in each unit, (units,)."""
    ours = signals.played(sound, samplerate, form="reference", parameters=parameters)
    unit = parameters.window_frames(samplerate)
    names = ("window_s", "band_low_hz", "band_high_hz", "vibration_top_hz", "partials_max")
    values = {name: getattr(parameters, name) for name in names}
    theirs = oracle_vibration(sound, samplerate, threshold=parameters.threshold_hz, **values)
    apart = np.abs(ours[unit:, 0] - theirs)
    return np.maximum.reduceat(apart, np.arange(0, apart.size, unit))


def assert_agreement(apart):
    assert np.mean(np.concatenate(apart) <= AGREEMENT) >= UNITS_AGREEING


@pytest.mark.exhaustive
def test_it_agrees_with_the_oracle_on_every_recording():
    sounds = [soundfile.read(path, always_2d=True) for path in require_recordings()]
    assert_agreement([disagreement(*sound) for sound in sounds])


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [44_100, 48_000, 8_000, 11_025])
def test_it_agrees_with_the_oracle_on_synthetic_sounds(samplerate):
    nyquist = samplerate / 2
    five = signals.five_tones if nyquist > 5_000 else partial(signals.tone, 440)
    begin, end = signals.tone(700, 0.15, samplerate), signals.tone(90, 0.1, samplerate)
    noise = signals.white_noise(0.3, samplerate, 0.3, seed=3)
    sounds = [
        five(0.6, samplerate),
        signals.tone(60, 0.4, samplerate, 1.0),
        signals.chirp(60, min(11_000.0, 0.9 * nyquist), 0.6, samplerate),
        signals.white_noise(0.4, samplerate, 1.0, seed=1),
        signals.low_noise(0.4, samplerate, 0.1, seed=2),
        signals.square(97, 0.4, samplerate),
        signals.joined(begin, signals.silence(0.2, samplerate), end),
        signals.one_sample(0.3, samplerate, 0.13),
        np.ones(round(0.3 * samplerate)),
        signals.columns(signals.tone(300, 0.3, samplerate), noise),
    ]
    assert_agreement([disagreement(sound, samplerate) for sound in sounds])


@pytest.mark.sweep
@pytest.mark.parametrize("parameters", OTHER_PARAMETERS.values(), ids=OTHER_PARAMETERS)
def test_it_agrees_with_the_oracle_under_other_parameters(parameters):
    noise = signals.white_noise(0.3, 44_100, 0.5, seed=4)
    sound = signals.joined(signals.five_tones(0.4, 44_100), noise, signals.tone(333, 0.2, 44_100))
    assert_agreement([disagreement(sound, 44_100, parameters)])


@pytest.mark.exhaustive
@given(
    partials=st.lists(
        st.tuples(st.floats(50, 12_000), st.floats(0.003, 1.0), st.floats(0, 6.28)),
        min_size=1,
        max_size=24,
    ),
    noise=st.sampled_from([0.0, 1e-3, 0.03, 0.5]),
    seed=st.integers(0, 2**32 - 1),
    samplerate=st.sampled_from([16_000, 44_100, 48_000]),
)
@settings(max_examples=60)
def test_it_agrees_with_the_oracle_on_any_mix_but_for_ties(partials, noise, seed, samplerate):
    sound = signals.white_noise(0.14, samplerate, noise, seed)
    for hz, amplitude, phase in partials:
        sound += signals.tone(min(hz, 0.45 * samplerate), 0.14, samplerate, amplitude, phase)
    apart = disagreement(sound, samplerate)
    for unit in (apart > AGREEMENT).nonzero()[0]:
        # r lies within rounding of the threshold or of another r
        low, high = (PARAMETERS.threshold_hz * factor for factor in (1 - 1e-7, 1 + 1e-7))
        more, fewer = (
            oracle_units(sound, samplerate, threshold=threshold, partials_max=1_000)[unit]
            for threshold in (low, high)
        )
        r = np.sort([principal.r for principal in more])
        tied = len(more) != len(fewer) or (np.diff(r) < 1e-7 * r[1:]).any()
        assert tied, f"unit {unit} is {apart[unit]:.2g} off"


@pytest.mark.parametrize("samplerate", [44_100, 48_000])
@pytest.mark.parametrize("amplitude", [0.05, 0.15, 0.2])
def test_unit_39_of_the_papers_five_tones_holds_these_five_and_nothing_else(samplerate, amplitude):
    form = ReferenceTransform(PARAMETERS, samplerate)
    units = form.cut(signals.five_tones(2.0, samplerate, amplitude))
    start_s = 39 * PARAMETERS.window_frames(samplerate) / samplerate
    assert start_s <= 1.83 < start_s + PARAMETERS.window_s
    found = form.analyse(units[39:40])
    # 0.5 Hz is a twentieth of a bin: more than the tones' side lobes shift one another.
    np.testing.assert_allclose(found.audio_hz, signals.FIVE_TONES_HZ, rtol=0, atol=0.5)


def test_the_five_tones_and_the_band_are_felt_where_the_paper_says_and_not_limited():
    felt = vibration_hz(np.array([50.0, *signals.FIVE_TONES_HZ, 12_000.0]), PARAMETERS)
    expected = [1 / 0.04643, 46.6, 92.0, 128.2, 140.9, 182.0, 220.0]
    np.testing.assert_allclose(felt, expected, rtol=0, atol=0.05)
    assert PARAMETERS.vibration_bottom_hz == pytest.approx(21.54, abs=0.005)
    assert PARAMETERS.scale_hz == pytest.approx(36.21, abs=0.005)
    sound = signals.tone(1_000, 0.5, 48_000, 3.0)
    transform = signals.made(sound, 48_000, form="reference")
    assert np.abs(transform.process(sound)).max() > 2.5
    assert transform.limited_samples == 0


@pytest.mark.parametrize(("samplerate", "frames"), [(44_100, 2_048), (48_000, 2_229)])
def test_a_unit_has_as_many_frames_as_the_paper_says(samplerate, frames):
    assert PARAMETERS.window_frames(samplerate) == frames
    assert HapticTransform(samplerate, form="reference").latency_frames == frames


@pytest.mark.parametrize("units", [0, 1, 2.5, 4])
def test_the_vibration_is_as_long_as_the_sound_and_stands_at_its_own_time(units):
    unit = PARAMETERS.window_frames(44_100)
    sound = signals.tone(800, 1.0, 44_100)[: round(units * unit)]
    transform = signals.made(sound, 44_100, form="reference")
    during, after = transform.process(sound), transform.finish()
    assert (during.shape, after.shape) == ((sound.size, 1), (unit, 1))
    shifted = np.concatenate((during, after))[unit:, 0]
    np.testing.assert_allclose(shifted, oracle_vibration(sound, 44_100), rtol=0, atol=AGREEMENT)


RATE = 48_000


def single(values):
    return np.asarray(values, np.float32)


def both_ways(superposition, weight, hz, edges):
    units = (slice(*unit) for unit in pairwise(edges))
    exact = np.stack([superposition.exact(weight[unit], hz[unit]) for unit in units])
    return exact, superposition.single(weight, hz, edges)


@pytest.mark.parametrize(
    ("frames", "samplerate", "top_hz"),
    [(2_229, 48_000, 220.0), (2_048, 44_100, 220.0), (46, 1_000, 60.0), (38_400, 192_000, 400.0)],
)
def test_rounded_to_float32_every_sample_is_that_of_the_equation(frames, samplerate, top_hz):
    superposition = Superposition(frames, samplerate)
    counts = [3, 0, 16, 1, 64, 0] * 4  # partials of each unit
    generator, edges = np.random.default_rng(3), np.concatenate(([0], np.cumsum(counts)))
    weight = 10.0 ** generator.uniform(-4.0, 0.5, edges[-1])
    hz = generator.uniform(10.0, top_hz, edges[-1])
    exact, quick = both_ways(superposition, weight, hz, edges)
    assert quick.shape == (len(counts), frames)
    assert signals.identical(single(quick), single(exact))
    assert not quick[1].any()


def test_sums_on_an_edge_of_float32_go_as_the_equation_and_only_there_the_quick_way(monkeypatch):
    # One partial each, as strong as it takes to bring one frame half-way between two floats.
    frames, units = 2_229, 500
    generator = np.random.default_rng(5)
    hz, frame = generator.uniform(20.0, 220.0, units), generator.integers(1, frames, units)
    cosine = np.cos(hz * (2.0 * np.pi * np.arange(frames) / RATE)[frame])
    below = single(0.3 * cosine)
    weight = (0.5 * (below.astype(float) + np.nextafter(below, single(9.0)))) / cosine
    superposition, edges = Superposition(frames, RATE), np.arange(units + 1)
    exact, quick = both_ways(superposition, weight, hz, edges)
    assert signals.identical(single(quick), single(exact))
    monkeypatch.setattr(Superposition, "_redo", lambda *_: None)
    unsettled = superposition.single(weight, hz, edges)
    assert np.count_nonzero(single(unsettled) != single(exact)) > 0.1 * units
    monkeypatch.setattr(Superposition, "single", lambda *_: pytest.fail("summed the quick way"))
    assert HapticTransform(RATE, 1, form="reference").process(signals.white_noise(0.2, RATE)).any()


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize(
    "sound",
    [
        *(
            signals.white_noise(3.0, RATE),
            signals.five_tones(3.0, RATE),
            signals.chirp(20.0, 20_000.0, 3.0, RATE),
        ),
        signals.silence(0.5, RATE),
    ],
    ids=["noise", "five tones", "chirp", "silence"],
)
def test_vibration_wanted_as_float32_is_the_reference_forms(sound, per_channel):
    both = signals.columns(sound, 0.3 * sound[::-1])
    options = {"form": "reference", "per_channel": per_channel}
    exact = signals.played(both, RATE, **options)
    for blocksize in (1_000, 32_768):
        blocks = [blocksize] * (sound.size // blocksize)
        quick = signals.in_blocks(both, blocks, RATE, single=True, **options)
        assert signals.identical(single(quick), single(exact))
        assert not (exact.any() and signals.identical(quick, exact))


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

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.synthesis import TrackingDesign
from audioflinger_hook.transform.mapping import VibrationMapping
from tests.oracle.partials import merge, merging_hz
from tests.support.signals import envelope, identical, joined, opened, played, silence, tone
from tests.transform.test_kernel import assert_agree
from tools.bench.measures.steadiness import rises_s

RATE = 16_000
PROFILES = ("cinema", "game", "music")
CHORD_HZ = (220.0, 277.18, 329.63)
CINEMA = parameters_of("cinema")
TRACKING = TrackingDesign.of(replace(CINEMA, merge_ratio=0.6), 0.018)


def merged(hz, amplitude, sounding_hz=(), design=TRACKING):
    return merge(design, np.asarray(hz), np.asarray(amplitude), list(sounding_hz))


def modulation(vibration, samplerate=RATE):
    """Return the depth of the envelope's swings at 4 to 16 Hz; 1.5 s and 0.5 s at the ends do not
    count: what begins, and what an envelope makes of an end."""
    level = envelope(vibration, samplerate)[:: samplerate // 1_000]
    swings = sosfiltfilt(butter(2, (4.0, 16.0), "bandpass", fs=1_000, output="sos"), level)
    return float(np.sqrt(2.0) * swings[1_500:-500].std() / level[1_500:-500].mean())


def tones(audio_hz, seconds, samplerate=RATE, amplitude=0.15, turn=1.0):
    every = enumerate(audio_hz)
    sines = [tone(hz, seconds, samplerate, amplitude, turn * place) for place, hz in every]
    return np.asarray(np.sum(sines, axis=0))


def pink_noise(seconds, samplerate=RATE, rms=0.1, seed=0):
    """Return noise of equal power in every octave above 20 Hz."""
    frames = round(seconds * samplerate)
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(frames))
    spectrum /= np.sqrt(np.maximum(np.fft.rfftfreq(frames, 1 / samplerate), 20.0))
    spectrum[0] = 0.0
    noise = np.fft.irfft(spectrum, frames)
    return rms / float(noise.std()) * noise


def clicks(a_second, seconds, samplerate=RATE, height=0.5):
    sound = silence(seconds, samplerate)
    sound[samplerate // 10 :: round(samplerate / a_second)] = height
    return sound


PARTIAL = st.tuples(st.floats(20.0, 220.0), st.floats(1e-6, 1.0))
PARTIALS = st.lists(PARTIAL, min_size=1, max_size=24).map(sorted)
SOUNDING = st.lists(st.floats(20.0, 220.0), max_size=24)


@pytest.mark.parametrize("base_hz", [25.0, 40.0, 80.0, 150.0])
def test_close_partials_become_one_of_the_same_energy_and_farther_ones_stay_two(base_hz):
    for apart_hz in range(1, 12):
        hz, amplitude, dominance = merged([base_hz, base_hz + apart_hz], [0.3, 0.4])
        assert amplitude == pytest.approx([0.5])
        assert hz == pytest.approx([base_hz + apart_hz * 0.64])
        assert dominance == pytest.approx([0.64])
    pair = [base_hz, base_hz + 1.01 * float(merging_hz(TRACKING, base_hz))]
    hz, amplitude, dominance = merged(pair, [0.3, 0.4])
    assert (hz, amplitude) == (pytest.approx(pair), pytest.approx([0.3, 0.4]))
    assert dominance.tolist() == [1.0, 1.0]


def test_beats_of_up_to_12_hz_are_gone_where_a_small_ratio_would_leave_them():
    design = replace(TRACKING, merge_ratio=0.1)
    for base_hz in (25.0, 60.0, 100.0):
        # Of partials 12 Hz apart, from one that sounds; of new ones four fifths as far.
        pair = [base_hz, base_hz + 11.9]
        assert merged(pair, [0.3, 0.4], [base_hz], design)[0].size == 1
        assert merged([base_hz, base_hz + 9.5], [0.3, 0.4], pair, design)[0].size == 1
        assert merged([base_hz, base_hz + 12.5], [0.3, 0.4], (), design)[0].size == 2


@pytest.mark.parametrize("ratio", [0.35, 0.6, 1.0])
@given(partials=PARTIALS, sounding_hz=SOUNDING)
def test_whatever_sounds_groups_are_never_close_and_keep_all_energy(ratio, partials, sounding_hz):
    design = replace(TRACKING, merge_ratio=ratio)
    hz, amplitude = np.array(partials).T
    group_hz, group_amplitude, dominance = merged(hz, amplitude, sounding_hz, design)
    assert 1 <= group_hz.size <= hz.size
    for one, other in pairwise(group_hz.tolist()):
        assert other - one >= design.merge_again * float(merging_hz(design, one)) * (1 - 1e-12)
    energy = amplitude**2
    assert (group_amplitude**2).sum() == pytest.approx(energy.sum(), rel=1e-9)
    # The mean frequency by energy is kept, too.
    assert (group_amplitude**2 * group_hz).sum() == pytest.approx((energy * hz).sum(), rel=1e-9)
    assert ((dominance > 0.0) & (dominance <= 1.0)).all()
    assert ((group_hz >= hz.min() - 1e-9) & (group_hz <= hz.max() + 1e-9)).all()
    assert hz.size > 1 or dominance.tolist() == [1.0]


@given(PARTIALS, st.lists(st.floats(20.0, 220.0), max_size=24, unique=True), st.randoms())
def test_the_order_of_what_sounds_does_not_matter(partials, sounding_hz, random):
    hz, amplitude = np.array(partials).T
    distances = np.abs(hz[:, None] - np.array(sounding_hz)[None, :])
    if any(np.unique(row).size < row.size for row in distances):
        return
    found = merged(hz, amplitude, sounding_hz)
    random.shuffle(sounding_hz)
    for one, other in zip(found, merged(hz, amplitude, sounding_hz), strict=True):
        assert identical(one, other)


@pytest.mark.parametrize("sounding_hz", [[], [30.0, 90.0]])
def test_nothing_and_partials_without_amplitude_give_no_group(sounding_hz):
    for hz, amplitude in (([], []), ([40.0, 50.0], [0.0, 0.0])):
        assert all(part.shape == (0,) for part in merged(hz, amplitude, sounding_hz))


def test_what_sounds_keeps_its_partials_and_groups_that_wander_a_little_stay():
    distance = float(merging_hz(TRACKING, 60.0))
    # Two that sound, between merge_again and the whole distance, stay two; what is new, one.
    pair = [60.0, 60.0 + 0.9 * distance]
    assert merged(pair, [0.3, 0.3], pair)[0].size == 2
    assert merged(pair, [0.3, 0.3])[0].size == 1
    assert merged(pair, [0.3, 0.3], [75.0])[0].size == 1
    pair = [60.0, 60.0 + 0.7 * distance]
    assert merged(pair, [0.3, 0.3], pair)[0].size == 1
    # 40 Hz reaches to 64 Hz, 66 Hz from 26.4 Hz on: 54 Hz belongs to that which is nearer.
    joined_one, alone = np.hypot(0.3, 0.1), 0.3
    for middle_hz, expected in ((52.0, [joined_one, alone]), (54.0, [alone, joined_one])):
        found = merged([40.0, middle_hz, 66.0], [0.3, 0.1, 0.3], [40.0, 66.0])
        assert found[1] == pytest.approx(expected)


@pytest.mark.parametrize("base_hz", [40.0, 70.0, 110.0])
@pytest.mark.parametrize("apart_hz", [4.0, 6.0, 8.0, 10.0, 12.0])
def test_tones_mapped_close_together_are_felt_as_a_steady_one(base_hz, apart_hz):
    # Their own beats, 33 Hz and more, are faster than what is measured, so none is in the sound.
    mapping = VibrationMapping.of(CINEMA)
    sound = tones([mapping.audio_hz(base_hz), mapping.audio_hz(base_hz + apart_hz)], 3.0)
    assert modulation(played(sound, RATE, parameters=CINEMA)[:, 0]) < 0.12


def test_beats_that_are_in_the_sound_are_felt():
    assert modulation(played(tones([110.0, 118.0], 3.0), RATE, parameters=CINEMA)[:, 0]) > 0.25


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("samplerate", [RATE, 8_000, 48_000])
def test_a_steady_chord_and_steady_noise_are_felt_steady(profile, samplerate):
    parameters = parameters_of(profile)
    for turn in (0.0, 1.0, 2.5):
        sound = tones(CHORD_HZ, 3.0, samplerate, turn=turn)
        vibration = played(sound, samplerate, parameters=parameters)[:, 0]
        assert modulation(vibration, samplerate) < 0.12
    vibration = played(pink_noise(6.0, samplerate), samplerate, parameters=parameters)[:, 0]
    assert modulation(vibration, samplerate) < 0.25


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("a_second", [1, 5, 10])
def test_up_to_ten_clicks_a_second_are_felt_one_by_one(profile, a_second):
    sound = clicks(a_second, 4.0)
    felt_s = rises_s(played(sound, RATE, parameters=parameters_of(profile))[:, 0], RATE)
    # The first rises from silence as the last falls: at ten a second one of forty may be missed.
    assert felt_s.size == pytest.approx(4 * a_second, abs=a_second // 10)
    # Each comes with its click; onsets share one latency.
    assert np.diff(felt_s) == pytest.approx(np.full(felt_s.size - 1, 1 / a_second), abs=0.03)


@pytest.mark.parametrize("profile", PROFILES)
def test_fifty_clicks_a_second_are_no_impacts(profile):
    # Some warble stays, but less than of clicks felt one by one, whose envelope swings by over 1.
    vibration = played(clicks(50, 4.0), RATE, parameters=parameters_of(profile))[:, 0]
    assert modulation(vibration) < 0.35
    level = envelope(vibration, RATE, 20.0)[::16][1_500:3_500]
    assert level.min() > 0.15 * level.max()


def oscillators(parameters):
    """Return the slots that sound and their Hz, at the end of each hop of a chord that goes on."""
    transform = opened(RATE, 1, parameters=parameters)
    transform.process(tones(CHORD_HZ, 1.0))
    transform.take_glides()
    transform.process(tones(CHORD_HZ, 2.0)[RATE:])
    glides = transform.take_glides()
    hops = [glides[glides[:, 0] == frame] for frame in np.unique(glides[:, 0])]
    ends = [hop[hop[:, 7] > 0.0] for hop in hops]
    return [(tuple(end[:, 3]), end[:, 5]) for end in ends]


def test_the_paper_s_partials_are_not_merged_and_those_that_are_stay_one_oscillator():
    for parameters in (TransformParameters(), parameters_of("paper")):
        assert parameters.merge_ratio == 0.0
        assert {len(slots) for slots, _ in oscillators(parameters)} == {len(CHORD_HZ)}
    assert {len(slots) for slots, _ in oscillators(CINEMA)} == {1}
    hops = oscillators(CINEMA)
    assert len(hops) > 50
    assert len({slots for slots, _ in hops}) == 1
    assert np.ptp(np.array([hz for _, hz in hops]), axis=0).max() < 1.0


def sounds():
    chord = joined(tones(CHORD_HZ, 0.6), tones((330.0, 392.0, 494.0, 523.0), 0.5))
    return {
        "chord": chord,
        "noise": pink_noise(0.8),
        "clicks": clicks(12, 1.0),
        "all": joined(chord, silence(0.5, RATE), pink_noise(0.4, rms=0.3), clicks(30, 0.4)),
    }


@pytest.mark.parametrize("ratio", [0.35, 0.6])
@pytest.mark.parametrize("kind", sounds())
def test_the_core_merges_as_its_oracle_does(ratio, kind):
    sound = sounds()[kind]
    few = (replace(CINEMA, partials_max=most) for most in (1, 2, 64))
    for one in (CINEMA, parameters_of("game"), TransformParameters(), *few):
        assert assert_agree(sound, RATE, parameters=replace(one, merge_ratio=ratio)).any()

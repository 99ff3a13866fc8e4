from itertools import pairwise

import numpy as np
import pytest

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core.structures import GLIDE_COLUMNS
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from tests.oracle import vibration_of
from tests.support.signals import columns, identical, joined, opened, played, silence, tone

RATE = 48_000
PIECE_FRAMES = 3_001


def tones(*hertz, seconds=0.5):
    return np.sum([tone(hz, seconds, RATE, 0.2, 0.0) for hz in hertz], axis=0)


def struck_tones():
    struck = tone(300.0, 0.4, RATE, 0.5, 0.0) * np.exp(-8.0 * np.arange(19_200) / RATE)
    rests = [silence(frames / RATE, RATE) for frames in (4_801, 30_007, 20_000)]
    return joined(rests[0], struck, rests[1], 0.5 * struck, rests[2]).astype(np.float32)


def in_order(rows):
    return rows[np.lexsort((rows[:, 3], rows[:, 2], rows[:, 0]))]


def glides_of(transform, sound):
    """Return the recorded rows in order, and the vibration."""
    assert len(transform.take_glides()) == 0
    rows, parts = [], []
    for first in range(0, len(sound), PIECE_FRAMES):
        parts.append(transform.process(sound[first : first + PIECE_FRAMES]))
        rows.append(transform.take_glides())
        _ = transform.principal
    parts.append(transform.finish())
    return in_order(np.concatenate([*rows, transform.take_glides()])), np.concatenate(parts)


def test_a_tone_is_told_with_the_vibration_it_is_mapped_to():
    transform = opened(RATE, 1)
    assert not transform.principal
    vibration = transform.process(tones(440.0))
    [(audio_hz, hz, amplitude)] = transform.principal
    assert audio_hz == pytest.approx(440.0, abs=0.2)
    assert hz == pytest.approx(vibration_hz(np.array([audio_hz]), TransformParameters())[0])
    assert amplitude == pytest.approx(np.abs(vibration[-4_800:]).max(), rel=0.05)


def test_silence_a_reset_and_the_reference_form_tell_nothing():
    transform = opened(RATE, 1)
    transform.process(joined(tones(440.0), silence(1.0, RATE)))
    assert transform.principal == ()
    transform.process(tones(440.0))
    transform.reset()
    assert transform.principal == ()
    transform = opened(RATE, 1, "reference")
    transform.process(tones(440.0))
    assert (transform.principal, transform.take_glides().shape) == ((), (0, len(GLIDE_COLUMNS)))


@pytest.mark.parametrize("per_channel", [False, True])
def test_the_core_tells_of_every_hop_what_its_oracle_does(per_channel):
    sound = columns(tones(100.0, 350.0, 950.0, 1350.0, 4200.0), tones(200.0, 500.0))
    transform, begin = opened(RATE, 2, per_channel=per_channel), 0
    for end, told in vibration_of(sound, RATE, per_channel=per_channel).told:
        if end <= len(sound):
            transform.process(sound[begin:end])
            assert np.allclose(sorted(transform.principal), sorted(told), rtol=1e-6)
            begin = end
    assert len(transform.principal) >= 5


def test_of_too_many_the_strongest_are_told():
    chord = tones(100.0, 350.0, 950.0, 2500.0)
    sound = columns(*(0.02 * (channel + 1) * chord for channel in range(8)))
    transform, single = opened(RATE, 8, per_channel=True), opened(RATE, 1)
    transform.process(sound)
    single.process(sound[:, 7:])
    assert len(transform.principal) == 16
    for _, hz, amplitude in single.principal:
        assert any(np.allclose((hz, amplitude), one[1:], rtol=1e-6) for one in transform.principal)


@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_asking_and_recording_change_no_sample(profile):
    parameters = parameters_of(profile)
    _, vibration = glides_of(opened(RATE, 1, parameters=parameters), struck_tones())
    assert identical(vibration, played(struck_tones(), RATE, parameters=parameters))


def test_glides_of_one_slot_join_in_time_and_in_phase():
    rows, _ = glides_of(opened(RATE, 1), struck_tones())
    assert rows.shape[1] == len(GLIDE_COLUMNS)
    joins = 0
    for slot in np.unique(rows[:, 3]):
        for before, after in pairwise(rows[rows[:, 3] == slot]):
            if before[0] + before[1] != after[0] or before[7] == 0.0:
                continue
            joins += 1
            assert after[6] == before[7]
            turns = before[8] + 0.5 * (before[4] + before[5]) * before[1] / RATE
            assert abs((turns - after[8] + 0.5) % 1.0 - 0.5) < 1e-9
    assert joins > 10


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_the_core_records_the_glides_of_its_oracle(per_channel, profile):
    sound = columns(struck_tones(), struck_tones()[::-1])
    options = {"parameters": parameters_of(profile), "per_channel": per_channel}
    found, _ = glides_of(opened(RATE, 2, **options), sound)
    expected = in_order(vibration_of(sound, RATE, **options).glides)
    assert len(found) > 20
    # Times, voices and slots are whole numbers; the rest differs by rounding.
    assert np.array_equal(found[:, :4], expected[:, :4])
    assert np.allclose(found, expected, rtol=1e-6, atol=1e-9)

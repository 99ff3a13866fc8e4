"""Hops begin with the sound: after silence it gives the same vibration, whenever it comes."""

import numpy as np
import pytest

from tests.oracle import vibration_of
from tests.support.signals import columns, in_blocks, played, times, tone

RATE = 48_000
HOP = 864


def sound(seconds=1.0, seed=0):
    """Return noise bursts over a tone: envelopes that depend much on where hops begin."""
    at = times(seconds, RATE)
    bursts = np.random.default_rng(seed).standard_normal(at.size)
    wave = tone(200, seconds, RATE, 0.2) + 0.2 * bursts * (np.sin(2 * np.pi * 4.3 * at) > 0.6)
    return columns(wave, 0.5 * wave).astype(np.float32)


def after(frames, following):
    return np.concatenate([np.zeros((frames, 2), np.float32), following])


PAUSES = [(0.0, pause) for pause in (1, 333, 480, HOP, 5_000, 60_001, 12 * RATE + 331)]


@pytest.mark.parametrize(("seconds", "pause"), [*PAUSES, (1.0, 40_001), (1.0, 96_123)])
def test_silence_only_delays_what_follows_once_vibration_has_faded(seconds, pause):
    one, other = sound(seconds, seed=1), sound(seed=2)
    got = played(np.concatenate([one, after(pause, other)]), RATE)
    assert seconds or not got[:pause].any()
    np.testing.assert_allclose(got[len(one) + pause :], played(other, RATE), rtol=0.0, atol=1e-9)


def test_the_core_begins_hops_where_its_oracle_does_and_a_short_gap_moves_none():
    rng = np.random.default_rng(3)
    pauses = rng.integers(0, 70_000, 6)
    frames = np.concatenate([after(pause, sound(0.3, seed)) for seed, pause in enumerate(pauses)])
    frames[100_000:100_010, 1] = np.nan
    got = in_blocks(frames, rng.integers(1, 3_000, len(frames) // 1_500), RATE)
    np.testing.assert_allclose(got, vibration_of(frames, RATE).samples, rtol=0.0, atol=1e-6)
    one, other = sound(seed=1), sound(seed=2)
    got = played(np.concatenate([one, after(1_500, other)]), RATE)
    whole = len(one) // HOP * HOP
    np.testing.assert_allclose(got[:whole], played(one, RATE)[:whole], rtol=0.0, atol=1e-9)
    assert np.abs(got).max() < 1.0


def test_the_reference_form_cuts_its_units_from_the_beginning_on():
    got = played(after(333, sound()), RATE, form="reference")
    wanted = played(sound(), RATE, form="reference")
    assert np.abs(got[333:] - wanted).max() > 1e-3

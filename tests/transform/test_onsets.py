"""Hops begin with the sound: after silence it gives the same vibration, whenever it comes."""

from __future__ import annotations

import numpy as np
import pytest

from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.haptic import Form
from tests.oracle import vibration_of

RATE = 48_000
HOP = 864


def sound(seconds: float = 1.0, seed: int = 0) -> FloatArray:
    """Stereo noise bursts over a tone: envelopes that depend much on where hops begin."""
    rng = np.random.default_rng(seed)
    at = np.arange(int(seconds * RATE)) / RATE
    bursts = rng.standard_normal(at.size) * (np.sin(2 * np.pi * 4.3 * at) > 0.6)
    wave = 0.2 * np.sin(2 * np.pi * 200 * at + 0.3) + 0.2 * bursts
    return np.column_stack([wave, 0.5 * wave]).astype(np.float32)


def vibration(frames: FloatArray, form: Form = "live") -> FloatArray:
    transform = HapticTransform(RATE, 2, form=form)
    return np.concatenate([transform.process(frames), transform.finish()])[:, 0]


def after(silence: int, frames: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros((silence, 2), np.float32), frames])


@pytest.mark.parametrize("silence", [1, 333, 480, HOP, 5_000, 60_001])
def test_silence_before_a_sound_only_delays_its_vibration(silence: int) -> None:
    wanted = vibration(sound())
    got = vibration(after(silence, sound()))
    np.testing.assert_array_equal(got[:silence], 0.0)
    np.testing.assert_allclose(got[silence:], wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("pause", [40_001, 96_123])
def test_so_does_a_pause_in_which_the_vibration_has_faded(pause: int) -> None:
    one, other = sound(seed=1), sound(seed=2)
    together = np.concatenate([one, np.zeros((pause, 2), np.float32), other])
    got = vibration(together)[len(one) + pause :]
    np.testing.assert_allclose(got, vibration(other), rtol=0.0, atol=1e-9)


def test_a_short_gap_moves_no_hop() -> None:
    one, other = sound(seed=1), sound(seed=2)
    gap = np.zeros((1_500, 2), np.float32)
    got = vibration(np.concatenate([one, gap, other]))
    whole = len(one) // HOP * HOP
    np.testing.assert_allclose(got[:whole], vibration(one)[:whole], rtol=0.0, atol=1e-9)
    assert np.abs(got).max() < 1.0


def test_the_core_begins_hops_where_its_oracle_does_whatever_the_blocks() -> None:
    rng = np.random.default_rng(3)
    parts: list[FloatArray] = []
    for seed in range(6):
        parts += [np.zeros((int(rng.integers(0, 70_000)), 2), np.float32), sound(0.3, seed)]
    frames = np.concatenate(parts)
    frames[100_000:100_010, 1] = np.nan
    wanted = vibration_of(frames, RATE).samples[:, 0]
    transform = HapticTransform(RATE, 2)
    pieces, first = [], 0
    while first < len(frames):
        count = int(rng.integers(1, 3_000))
        pieces.append(transform.process(frames[first : first + count]))
        first += count
    got = np.concatenate([*pieces, transform.finish()])[:, 0]
    np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-6)


def test_the_reference_form_cuts_its_units_from_the_beginning_on() -> None:
    got = vibration(after(333, sound()), "reference")
    wanted = vibration(sound(), "reference")
    assert np.abs(got[333:][: len(wanted)] - wanted).max() > 1e-3

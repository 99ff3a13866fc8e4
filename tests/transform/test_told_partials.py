"""What a transform tells of its latest hop: the tones of the sound and the vibration of each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from tests.oracle import vibration_of

RATE_HZ = 48_000


def tones(*hertz: float, seconds: float = 0.5) -> np.ndarray[Any, np.dtype[np.float32]]:
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    wave = sum(0.2 * np.sin(2.0 * np.pi * hz * time_s) for hz in hertz)
    return np.column_stack([wave, wave]).astype(np.float32)


def test_a_tone_is_told_with_the_vibration_it_is_mapped_to() -> None:
    transform = HapticTransform(RATE_HZ)
    assert not transform.principal
    vibration = transform.process(tones(440.0))
    told = transform.principal
    assert len(told) == 1
    audio_hz, hz, amplitude = told[0]
    assert audio_hz == pytest.approx(440.0, abs=0.2)
    assert hz == pytest.approx(vibration_hz(np.array([audio_hz]), TransformParameters())[0])
    assert amplitude == pytest.approx(np.abs(vibration[-4_800:]).max(), rel=0.05)


def test_silence_and_a_reset_tell_nothing() -> None:
    transform = HapticTransform(RATE_HZ)
    transform.process(tones(440.0))
    transform.process(np.zeros((RATE_HZ, 2), np.float32))
    assert transform.principal == ()
    transform.process(tones(440.0))
    transform.reset()
    assert transform.principal == ()


@pytest.mark.parametrize("per_channel", [False, True])
def test_the_core_tells_of_every_hop_what_its_oracle_does(per_channel: bool) -> None:
    sound = tones(100.0, 350.0, 950.0, 1350.0, 4200.0)
    sound[:, 1] = tones(200.0, 500.0)[:, 0]
    transform = HapticTransform(RATE_HZ, per_channel=per_channel)
    expected = vibration_of(sound, RATE_HZ, per_channel=per_channel).told
    begin = 0
    for end, told in expected:
        if end <= len(sound):
            transform.process(sound[begin:end])
            assert np.allclose(sorted(transform.principal), sorted(told), rtol=1e-6)
            begin = end
    assert len(transform.principal) >= 5


def test_of_too_many_the_strongest_are_told() -> None:
    sound = np.zeros((RATE_HZ // 2, 8), np.float32)
    for channel in range(8):
        levels = 0.02 * (channel + 1)
        sound[:, channel] = levels * tones(100.0, 350.0, 950.0, 2500.0)[:, 0]
    transform = HapticTransform(RATE_HZ, 8, per_channel=True)
    transform.process(sound)
    told = transform.principal
    assert len(told) == 16
    single = HapticTransform(RATE_HZ, 1)
    single.process(sound[:, 7:])
    for _, hz, amplitude in single.principal:
        assert any(np.allclose((hz, amplitude), one[1:], rtol=1e-6) for one in told)


def test_the_reference_form_tells_nothing() -> None:
    transform = HapticTransform(RATE_HZ, form="reference")
    transform.process(tones(440.0))
    assert transform.principal == ()


def test_asking_changes_no_byte() -> None:
    sound = tones(100.0, 350.0)
    asked, plain = (HapticTransform(RATE_HZ) for _ in range(2))
    parts = []
    for first in range(0, len(sound), 512):
        parts.append(asked.process(sound[first : first + 512]))
        _ = asked.principal
    assert np.array_equal(np.concatenate(parts), plain.process(sound))

"""The recording of glides: what the partials of the live form did, hop by hop and tick by tick."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core.structures import GLIDE_COLUMNS
from audioflinger_hook.transform import HapticTransform
from tests.oracle import vibration_of

RATE_HZ = 48_000
PIECE_FRAMES = 3_001


def struck_tones() -> np.ndarray[Any, np.dtype[np.float32]]:
    """Silence, a struck tone, silence of an odd length, and another one."""
    time_s = np.arange(round(0.4 * RATE_HZ)) / RATE_HZ
    tone = 0.5 * np.sin(2.0 * np.pi * 300.0 * time_s) * np.exp(-8.0 * time_s)
    rests = [np.zeros(4_801), np.zeros(30_007), np.zeros(20_000)]
    return np.concatenate([rests[0], tone, rests[1], 0.5 * tone, rests[2]]).astype(np.float32)


def glides_of(transform: HapticTransform, sound: Any) -> tuple[Any, Any]:
    """Return the recorded rows in order, and the vibration."""
    assert len(transform.take_glides()) == 0
    rows, parts = [], []
    for first in range(0, len(sound), PIECE_FRAMES):
        parts.append(transform.process(sound[first : first + PIECE_FRAMES]))
        rows.append(transform.take_glides())
    parts.append(transform.finish())
    found = np.concatenate([*rows, transform.take_glides()])
    return in_order(found), np.concatenate(parts)


def in_order(rows: Any) -> Any:
    return rows[np.lexsort((rows[:, 3], rows[:, 2], rows[:, 0]))]


@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_recording_changes_no_sample(profile: str) -> None:
    parameters = parameters_of(profile)
    sound = struck_tones()
    plain = HapticTransform(RATE_HZ, 1, parameters)
    expected = np.concatenate([plain.process(sound), plain.finish()])
    recorded = HapticTransform(RATE_HZ, 1, parameters)
    _, vibration = glides_of(recorded, sound)
    assert np.array_equal(vibration, expected)


def test_glides_of_one_slot_join_in_time_and_in_phase() -> None:
    rows, _ = glides_of(HapticTransform(RATE_HZ, 1), struck_tones())
    assert rows.shape[1] == len(GLIDE_COLUMNS)
    joins = 0
    for slot in np.unique(rows[:, 3]):
        mine = rows[rows[:, 3] == slot]
        for before, after in pairwise(mine):
            if before[0] + before[1] != after[0] or before[7] == 0.0:
                continue
            joins += 1
            assert after[6] == before[7]
            turns = before[8] + 0.5 * (before[4] + before[5]) * before[1] / RATE_HZ
            assert abs((turns - after[8] + 0.5) % 1.0 - 0.5) < 1e-9
    assert joins > 10


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_the_core_records_the_glides_of_its_oracle(per_channel: bool, profile: str) -> None:
    sound = np.column_stack([struck_tones(), struck_tones()[::-1]])
    parameters = parameters_of(profile)
    found, _ = glides_of(HapticTransform(RATE_HZ, 2, parameters, per_channel=per_channel), sound)
    expected = vibration_of(sound, RATE_HZ, parameters, per_channel=per_channel).glides
    assert len(found) > 20
    # Times, voices and slots are whole numbers; the rest differs by rounding.
    assert np.array_equal(found[:, :4], in_order(expected)[:, :4])
    assert np.allclose(found, in_order(expected), rtol=1e-6, atol=1e-9)


def test_the_reference_form_records_nothing() -> None:
    transform = HapticTransform(RATE_HZ, 1, form="reference")
    rows, _ = glides_of(transform, struck_tones())
    assert rows.shape == (0, len(GLIDE_COLUMNS))

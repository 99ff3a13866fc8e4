"""The factor that undoes the listener's volume."""

from __future__ import annotations

import math

import numpy as np
import pytest

from audioflinger_hook.daemon.capture_queue import UNDONE_MAX_DB, SoundGain, undoing


def test_frames_stay_the_same_object_without_a_volume() -> None:
    frames = np.ones((8, 2), np.float32)
    assert SoundGain().apply(frames) is frames


def test_a_volume_is_undone_over_one_buffer_and_exactly_from_then_on() -> None:
    gain, frames = SoundGain(), np.full((100, 2), 0.1, np.float32)
    gain.wanted = undoing(-20.0)
    changing, after = gain.apply(frames), gain.apply(frames)
    assert np.all(np.diff(changing[:, 0]) > 0.0)
    assert np.ptp(np.diff(changing[:, 0])) < 1e-6
    assert changing[-1, 0] == pytest.approx(1.0, rel=1e-6)
    assert after == pytest.approx(1.0, rel=1e-6)


def test_the_change_goes_on_after_a_buffer_without_frames() -> None:
    gain = SoundGain()
    gain.wanted = 2.0
    assert len(gain.apply(np.zeros((0, 2), np.float32))) == 0
    assert gain.apply(np.ones((4, 1), np.float32))[0, 0] == pytest.approx(1.25)


@pytest.mark.parametrize("volume_db", [-math.inf, -200.0, -UNDONE_MAX_DB])
def test_no_more_than_the_limit_is_undone(volume_db: float) -> None:
    assert undoing(volume_db) == pytest.approx(10.0 ** (UNDONE_MAX_DB / 20.0))


def test_a_volume_above_full_is_undone_as_well() -> None:
    assert undoing(11.0) == pytest.approx(10.0 ** (-11.0 / 20.0))

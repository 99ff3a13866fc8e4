"""The factor that undoes the listener's volume."""

from __future__ import annotations

import math

import numpy as np
import pytest

from audioflinger_hook.daemon.capture_queue import SoundGain, undone_db


def test_frames_stay_the_same_object_without_a_volume() -> None:
    frames = np.ones((8, 2), np.float32)
    assert SoundGain().apply(frames) is frames


def test_a_volume_is_undone_over_one_buffer_and_exactly_from_then_on() -> None:
    gain, frames = SoundGain(), np.full((100, 2), 0.1, np.float32)
    gain.wanted = 10.0
    changing, after = gain.apply(frames), gain.apply(frames)
    assert np.all(np.diff(changing[:, 0]) > 0.0)
    assert np.ptp(np.diff(changing[:, 0])) < 1e-6
    assert changing[-1, 0] == pytest.approx(1.0, rel=1e-6)
    assert after == pytest.approx(1.0, rel=1e-6)


def test_no_sample_goes_over_full_scale_where_a_volume_rose_before_its_factor_fell() -> None:
    gain = SoundGain()
    gain.wanted = 1000.0
    assert gain.apply(np.full((4, 1), 0.5, np.float32)).max() == 1.0
    assert gain.apply(np.full((4, 1), -0.5, np.float32)).min() == -1.0
    gain.wanted = 1.0
    gain.apply(np.ones((4, 1), np.float32))
    assert gain.apply(np.full((4, 1), 1.5, np.float32)).max() == 1.5


def test_the_change_goes_on_after_a_buffer_without_frames() -> None:
    gain = SoundGain()
    gain.wanted = 2.0
    assert len(gain.apply(np.zeros((0, 2), np.float32))) == 0
    assert gain.apply(np.full((4, 1), 0.4, np.float32))[0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize(("server", "limit_db"), [("PulseAudio", 40.0), ("PipeWire", 80.0)])
@pytest.mark.parametrize("volume_db", [-math.inf, -200.0, -80.0])
def test_no_more_than_the_servers_samples_bear_is_undone(
    volume_db: float, server: str, limit_db: float
) -> None:
    assert undone_db(volume_db, server) == -limit_db


def test_a_volume_of_10_percent_is_undone_wholly_on_pipewire() -> None:
    assert undone_db(-60.0, "PipeWire") == -60.0


def test_a_volume_above_full_is_undone_as_well() -> None:
    assert undone_db(11.0, "PulseAudio") == 11.0

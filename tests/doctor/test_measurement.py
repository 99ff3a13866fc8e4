"""The delay between two recordings of bursts, whose blocks arrive late by chance."""

import numpy as np
import pytest

from audioflinger_hook.doctor import measurement
from audioflinger_hook.doctor.facts import Delay, Facts
from audioflinger_hook.doctor.measurement import RATE_HZ, Recording, delay_between

BLOCK = 512


def recorded(delay_s: float, begins_s: float, level: float, late_s: float) -> Recording:
    """A recording that begins at begins_s; each block arrives up to late_s late."""
    time_s = begins_s + np.arange(round(measurement.LASTS_S * RATE_HZ)) / RATE_HZ
    sound = np.zeros(time_s.size, np.float32)
    for start_s in measurement.BURSTS_AT_S:
        since_s = time_s - start_s - delay_s
        is_on = (since_s >= 0.0) & (since_s < measurement.BURST_S)
        sound[is_on] = level * np.cos(2.0 * np.pi * 100.0 * since_s[is_on])
    random, recording = np.random.default_rng(1), Recording()
    for first in range(0, time_s.size - BLOCK, BLOCK):
        arrives_s = begins_s + (first + BLOCK) / RATE_HZ + random.uniform(0.0, late_s)
        recording.add(sound[first : first + BLOCK, None], arrives_s)
    return recording


@pytest.mark.parametrize("delay_s", [0.0, 0.012, 0.09, 0.25])
def test_a_delay_is_found_to_2_ms_although_blocks_arrive_late(delay_s: float) -> None:
    found = delay_between(recorded(0.0, 0.1, 0.3, 0.002), recorded(delay_s, 0.37, 0.05, 0.012))
    assert found.bursts >= 3
    assert found.delay_ms == pytest.approx(1e3 * delay_s, abs=2.0)


def test_silence_is_said_and_not_measured_and_nothing_is_played_without_a_daemon() -> None:
    silent, loud = recorded(0.0, 0.0, 0.0, 0.0), recorded(0.0, 0.0, 0.3, 0.0)
    assert "sound stayed silent" in delay_between(silent, loud).reason
    assert "vibration stayed silent" in delay_between(loud, silent).reason
    assert delay_between(Recording(), Recording()).delay_ms is None
    reason = "not measured: no daemon plays; start `cushion run`"
    assert measurement.measure(Facts()) == Delay(reason=reason)

"""The loop that steers the delay, alone: an integrator of drift closes it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.clock.delay_control import MAX_DEVIATION, SLEW, WIDE_FOR_S, RateLoop, TargetDelay

SAMPLERATE = 48_000


def closed(drift_ppm, start_frames, seconds, block=256):
    """Error in frames before each update, with the loop closed and no noise; and the loop."""
    loop = RateLoop(SAMPLERATE)
    error, errors = start_frames, []
    for _ in range(round(seconds * SAMPLERATE / block)):
        errors.append(error)
        error += block * (1 + 1e-6 * drift_ppm) - block * loop.update(error, block / SAMPLERATE)
    return np.array(errors), loop


@pytest.mark.parametrize("block", [64, 256, 2_048])
@pytest.mark.parametrize("ppm", [-300, 300])
def test_any_drift_is_learned_and_leaves_no_error(ppm, block):
    errors, loop = closed(ppm, 0.0, 120.0, block)
    assert abs(errors[-1]) < 0.01
    assert 1e6 * loop.z3 == pytest.approx(ppm, abs=0.1)
    assert np.abs(errors).max() < 0.0003 * SAMPLERATE


def test_an_error_is_within_a_quarter_after_eight_seconds_and_a_long_one_does_not_wind_up():
    errors, _ = closed(150.0, 240.0, 60.0)
    assert np.flatnonzero(np.abs(errors) > 0.00025 * SAMPLERATE)[-1] * 256 / SAMPLERATE < 8.0
    loop = RateLoop(SAMPLERATE)
    for _ in range(10_000):
        loop.update(1e6, 0.005)
    assert loop.z3 <= MAX_DEVIATION
    error, lowest = 1_000.0, 0.0
    for _ in range(10_000):
        error -= 256 * (loop.update(error, 256 / SAMPLERATE) - 1.0)
        lowest = min(lowest, error)
    assert lowest > -0.15 * 1_000


def test_the_band_narrows_after_ten_seconds_and_a_restart_widens_it_and_keeps_the_drift():
    assert closed(200.0, 0.0, WIDE_FOR_S - 0.1)[1].wide
    _, loop = closed(200.0, 0.0, WIDE_FOR_S + 60)
    assert not loop.wide
    loop.restart()
    assert loop.wide
    assert loop.ratio == pytest.approx(1.0002, abs=1e-6)


@given(st.lists(st.tuples(st.floats(), st.floats(1e-6, 10.0)), max_size=50))
def test_the_ratio_stays_within_its_limits_whatever_the_error(updates):
    loop = RateLoop(SAMPLERATE)
    for error, seconds in updates:
        ratio = loop.update(error, seconds)
        assert math.isfinite(ratio)
        assert abs(ratio - 1.0) <= MAX_DEVIATION * (1 + 1e-9)


def test_the_target_moves_slowly_unless_the_user_moves_it_or_frames_would_run_out():
    target = TargetDelay(0.01, 0.2 / 0.75, jump_s=0.005)
    target.set_goal(0.004, 0.0)
    assert target.move(1.0) == pytest.approx(SLEW)
    assert target.current_s == pytest.approx(0.01 + SLEW)
    target.set_goal(0.02, 0.0)
    assert target.current_s == pytest.approx(0.03)
    target.set_goal(0.001, 0.0)
    target.move(0.5)
    assert target.current_s == pytest.approx(0.03 - SLEW / 2)
    target.set_goal(0.001, 0.05)
    assert target.current_s == pytest.approx(0.08 - SLEW / 2)
    target.set_goal(0.001, 9.0)
    assert target.current_s == pytest.approx(0.2)

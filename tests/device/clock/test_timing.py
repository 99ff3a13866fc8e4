import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.clock.delay_control import MAX_DEVIATION, SLEW, WIDE_FOR_S, RateLoop, TargetDelay
from device.clock.frame_clock import FrameClock
from device.clock.stream_timing import LEAST_S, Lateness
from tests.support.clocks import Side


def errors(side: Side, seconds: float) -> tuple[np.ndarray, np.ndarray, FrameClock]:
    """Times of the callbacks, and how far the smoothed counter then is from the true one (s)."""
    clock = FrameClock(side.samplerate)
    rows = []
    for number, (now_s, true_s) in enumerate(side.callbacks()):
        if now_s > seconds:
            break
        reading: Any = clock.update(now_s, number * side.block)
        # both ways between time and counter are the same line
        assert abs(reading.time_of(reading.frames_at(now_s)) - now_s) < 1e-9
        true_frames = number * side.block + (now_s - true_s) * side.rate
        rows.append((now_s, (true_frames - reading.frames_at(now_s)) / side.rate))
    now, error = np.array(rows).T
    return now, error, clock


US, MS = 1e-6, 1e-3
BEATS = (470, 511, 513, 1_000)

STREAMS = {
    # the callbacks, and the largest error after 10 s, in seconds
    "no jitter, slow": (Side(ppm=-300, start_s=1.0), 1 * US),
    "no jitter": (Side(start_s=1.0), 1 * US),
    "no jitter, fast": (Side(ppm=300, start_s=1.0), 1 * US),
    # a fiftieth: callbacks are late by 0 to the jitter, and the 0 counts instead of the mean
    "jitter of 0.2 ms": (Side(ppm=150, jitter_s=0.2 * MS), 0.2 * MS / 50),
    "jitter of 2 ms": (Side(ppm=150, jitter_s=2 * MS), 2 * MS / 50),
    "jitter of 5 ms": (Side(ppm=150, jitter_s=5 * MS), 5 * MS / 50),
    "a pause of 80 ms": (Side(jitter_s=0.2 * MS, pauses=((20.0, 20.08),)), 50 * US),
}


@pytest.mark.parametrize("name", STREAMS)
def test_the_counter_is_known_far_better_than_single_callbacks_tell(name):
    side, limit_s = STREAMS[name]
    now, error, clock = errors(side, 60.0 if side.ppm == 150 else 30.0)
    assert np.abs(error[now > 10]).max() < limit_s
    assert clock.restarts == 0


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("options", "seconds"), [*(({"server_block": n}, 180.0) for n in BEATS), ({"burst": 4}, 60.0)]
)
def test_a_beat_between_blocks_or_a_burst_is_no_change_of_the_clock(options, seconds):
    now, error, clock = errors(Side(jitter_s=0.2 * MS, ppm=-100, **options), seconds)
    assert np.ptp(error[now > seconds / 3]) < 0.2 * MS
    assert clock.restarts == 0


@pytest.mark.sweep
@pytest.mark.parametrize("lost_s", [2.0, 0.008, 0.03, 0.2])
def test_frames_lost_in_the_stream_begin_a_new_line_within_half_a_second(lost_s):
    now, error, clock = errors(Side(jitter_s=0.0005, gaps=((20.0, 20.0 + lost_s),)), 40.0)
    assert np.abs(error[now > 20.5 + lost_s]).max() < 0.0005
    assert clock.restarts == 1


def test_a_jump_that_was_announced_begins_a_new_line_with_the_first_late_callback():
    clock, shift_s = FrameClock(48_000), 0.0
    for number in range(4_000):
        if number == 3_000:
            clock.expect_jump()
        if number == 3_010:
            shift_s = 0.08
        clock.update(number * 256 / 48_000 + shift_s, number * 256)
        assert clock.restarts == (number >= 3_010)


@pytest.mark.sweep
@pytest.mark.parametrize("seconds", [2.1, 0.5, 1.7, 1.9])
def test_a_backlog_of_any_length_is_forgotten_a_fifth_of_a_second_later(seconds):
    now, error, _ = errors(Side(jitter_s=0.0005, pauses=((20.0, 20.0 + seconds),)), 30.0)
    assert np.abs(error[now > 20.2 + seconds]).max() < 0.001


def test_the_pace_learned_survives_a_restart():
    _, _, clock = errors(Side(ppm=250, gaps=((30.0, 32.0),)), 32.1)
    assert clock.reading is not None
    assert clock.reading.frames_per_s == pytest.approx(48_000 * (1 + 250e-6), rel=20e-6)


times = st.floats(allow_nan=True, allow_infinity=True) | st.floats(0, 10)
counters = st.integers(-(10**9), 10**9) | st.integers(0, 5_000)


@given(st.lists(st.tuples(times, counters), max_size=60))
def test_whatever_comes_the_line_stays_finite(calls):
    clock = FrameClock(48_000)
    for now_s, frames in calls:
        reading = clock.update(now_s, frames)
        if reading is not None:
            assert math.isfinite(reading.time_s)
            assert reading.frames_per_s == pytest.approx(48_000, rel=2.1e-3)


def lateness_of(late_s: list[float]) -> Lateness:
    lateness = Lateness(0.05)
    for one in late_s:
        lateness.add(one, 0.005, False)
    return lateness


def test_one_callback_in_two_thousand_is_not_provided_for_and_one_in_five_hundred_is():
    for every, estimate_s in ((2_000, 0.002), (500, 0.02)):
        late_s = [0.02 if number % every == every // 2 else 0.002 for number in range(20_000)]
        assert lateness_of(late_s).estimate_s == pytest.approx(estimate_s, abs=0.0002)


def test_lateness_has_bounds_is_forgotten_and_counts_once_after_a_pause():
    assert lateness_of([-1.0, 0.0] * 5_000).estimate_s == LEAST_S
    assert lateness_of([7.0] * 5_000).estimate_s == 0.05
    # Twelve half-lives make the first 25 s less than a thousandth.
    lateness = lateness_of([0.01] * 5_000 + [0.002] * 150_000)
    assert lateness.estimate_s == pytest.approx(0.002, abs=0.0002)
    lateness = Lateness(0.05)
    for number in range(4_000):
        lateness.add(0.04 if 2_000 <= number < 2_015 else 0.001, 0.005, 2_000 <= number < 2_015)
    assert lateness.estimate_s == pytest.approx(0.001, abs=0.0002)


def test_lateness_does_not_wander_with_the_luck_of_the_tail():
    lateness, seen = Lateness(0.05), []
    for late_s in np.random.default_rng(0).exponential(0.0005, 60_000):
        lateness.add(late_s, 0.005, False)
        seen.append(lateness.estimate_s)
    changes = sum(one != other for one, other in itertools.pairwise(seen[20_000:]))
    assert changes <= 10


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

"""Callback times without their lateness: the line under them is the stream's own clock."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.clock.frame_clock import STRANDED_S, FrameClock
from device.clock.stream_timing import LEAST_S, Lateness
from tests.support.clocks import Side

EXHAUSTIVE = pytest.mark.exhaustive


def errors(side: Side, seconds: float) -> tuple[np.ndarray, np.ndarray, FrameClock]:
    """Times of the callbacks, and how far the smoothed counter then is from the true one (s)."""
    clock = FrameClock(side.samplerate)
    rows = []
    for number, (now_s, true_s) in enumerate(side.callbacks()):
        if now_s > seconds:
            break
        reading = clock.update(now_s, number * side.block)
        assert reading is not None
        true_frames = number * side.block + (now_s - true_s) * side.rate
        rows.append((now_s, (true_frames - reading.frames_at(now_s)) / side.rate))
    now, error = np.array(rows).T
    return now, error, clock


US, MS = 1e-6, 1e-3

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
def test_the_counter_is_known_far_better_than_single_callbacks_tell(name: str) -> None:
    side, limit_s = STREAMS[name]
    now, error, clock = errors(side, 60.0 if side.ppm == 150 else 30.0)
    assert np.abs(error[now > 10]).max() < limit_s
    assert clock.restarts == 0


@pytest.mark.sweep
@pytest.mark.parametrize("server_block", [470, 511, 513, 1_000])
def test_a_beat_between_blocks_is_no_change_of_the_clock(server_block: int) -> None:
    now, error, clock = errors(Side(server_block=server_block, jitter_s=0.0002, ppm=-100), 180.0)
    assert np.ptp(error[now > 60]) < 0.0002
    assert clock.restarts == 0


def test_bursts_are_smoothed_like_any_jitter() -> None:
    now, error, clock = errors(Side(burst=4), 60.0)
    assert np.ptp(error[now > 10]) < 100e-6
    assert clock.restarts == 0


def test_both_ways_between_time_and_counter_are_the_same_line() -> None:
    _, _, clock = errors(Side(ppm=100, jitter_s=0.001), 5.0)
    reading = clock.reading
    assert reading is not None
    assert reading.time_of(reading.frames_at(5.01)) == pytest.approx(5.01, abs=1e-12)


@pytest.mark.parametrize(
    "lost_s",
    [0.008, pytest.param(0.03, marks=EXHAUSTIVE), pytest.param(0.2, marks=EXHAUSTIVE), 2.0],
)
def test_frames_lost_in_the_stream_begin_a_new_line_within_half_a_second(lost_s: float) -> None:
    now, error, clock = errors(Side(jitter_s=0.0005, gaps=((20.0, 20.0 + lost_s),)), 40.0)
    assert np.abs(error[now > 20.5 + lost_s]).max() < 0.0005
    assert clock.restarts == 1


def test_a_jump_that_was_announced_begins_a_new_line_with_the_first_late_callback() -> None:
    clock, shift_s = FrameClock(48_000), 0.0
    for number in range(4_000):
        if number == 3_000:
            clock.expect_jump()
        if number == 3_010:
            shift_s = 0.08
        clock.update(number * 256 / 48_000 + shift_s, number * 256)
        assert clock.restarts == (number >= 3_010)


@pytest.mark.parametrize(
    "seconds",
    [0.5, pytest.param(1.7, marks=EXHAUSTIVE), pytest.param(1.9, marks=EXHAUSTIVE), 2.1],
)
def test_a_backlog_of_any_length_is_forgotten_a_fifth_of_a_second_later(seconds: float) -> None:
    side = Side(jitter_s=0.0005, pauses=((20.0, 20.0 + seconds),))
    now, error, _ = errors(side, 30.0)
    assert np.abs(error[now > 20.2 + seconds]).max() < 0.001


@pytest.mark.parametrize("blocks", [3, 5])
@pytest.mark.parametrize("at_s", [0.12, 0.5, 20.0])
def test_a_server_that_asks_for_some_blocks_too_early_once_is_forgiven_in_seconds(
    blocks: int, at_s: float
) -> None:
    clock, block_s = FrameClock(48_000), 256 / 48_000
    first = round(at_s / block_s)
    for number in range(round((at_s + 10.0) / block_s)):
        at = first if first <= number < first + blocks else number
        reading = clock.update(at * block_s, 256 * number)
        assert reading is not None
        if (number - first) * block_s > STRANDED_S + 2.0:
            assert reading.time_of(256 * number) == pytest.approx(number * block_s, abs=2e-4)
    assert clock.restarts == clock.strandings == 1


def test_the_pace_learned_survives_a_restart() -> None:
    _, _, clock = errors(Side(ppm=250, gaps=((30.0, 32.0),)), 32.1)
    assert clock.reading is not None
    assert clock.reading.frames_per_s == pytest.approx(48_000 * (1 + 250e-6), rel=20e-6)


@given(
    st.lists(
        st.tuples(
            st.floats(allow_nan=True, allow_infinity=True) | st.floats(0, 10),
            st.integers(-(10**9), 10**9) | st.integers(0, 5_000),
        ),
        max_size=60,
    )
)
def test_whatever_comes_the_line_stays_finite(calls: list[tuple[float, int]]) -> None:
    clock = FrameClock(48_000)
    for now_s, frames in calls:
        reading = clock.update(now_s, frames)
        if reading is not None:
            assert math.isfinite(reading.time_s)
            assert reading.frames_per_s == pytest.approx(48_000, rel=2.1e-3)


def lateness_of(late_s: list[float], limit_s: float = 0.05) -> Lateness:
    lateness = Lateness(limit_s)
    for one in late_s:
        lateness.add(one, 0.005, False)
    return lateness


def test_one_callback_in_two_thousand_is_not_provided_for_and_one_in_five_hundred_is() -> None:
    rare = [0.02 if number % 2_000 == 1_000 else 0.002 for number in range(20_000)]
    often = [0.02 if number % 500 == 250 else 0.002 for number in range(20_000)]
    assert lateness_of(rare).estimate_s == pytest.approx(0.002, abs=0.0002)
    assert lateness_of(often).estimate_s == pytest.approx(0.02, abs=0.0002)


def test_lateness_has_bounds_and_old_lateness_is_forgotten() -> None:
    assert lateness_of([-1.0, 0.0] * 5_000).estimate_s == LEAST_S
    assert lateness_of([7.0] * 5_000).estimate_s == 0.05
    # Twelve half-lives make the first 25 s less than a thousandth.
    lateness = lateness_of([0.01] * 5_000 + [0.002] * 150_000)
    assert lateness.estimate_s == pytest.approx(0.002, abs=0.0002)


def test_all_callbacks_after_one_pause_count_as_one() -> None:
    lateness = Lateness(0.05)
    for number in range(4_000):
        lateness.add(0.04 if 2_000 <= number < 2_015 else 0.001, 0.005, 2_000 <= number < 2_015)
    assert lateness.estimate_s == pytest.approx(0.001, abs=0.0002)


def test_lateness_does_not_wander_with_the_luck_of_the_tail() -> None:
    draw = np.random.default_rng(0)
    lateness = lateness_of([])
    seen = []
    for late_s in draw.exponential(0.0005, 60_000):
        lateness.add(late_s, 0.005, False)
        seen.append(lateness.estimate_s)
    changes = sum(one != other for one, other in itertools.pairwise(seen[20_000:]))
    assert changes <= 10

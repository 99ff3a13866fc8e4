"""Levels and times per buffer: right, bounded, and never harmed by what passes."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.service.meters import (
    FLOOR_DBFS,
    STEP,
    BufferClock,
    BufferTimes,
    Level,
    LevelMeter,
)

RATE = 48_000


def sine(amplitude: float, frames: int = RATE, channels: int = 2) -> np.ndarray:
    phase = 2.0 * np.pi * 1000.0 * np.arange(frames) / RATE
    return np.repeat(amplitude * np.sin(phase)[:, None], channels, 1).astype(np.float32)


@pytest.mark.parametrize("amplitude", [1.0, 0.1, 1e-4])
@pytest.mark.parametrize("size", [64, 441, 1024, 9000])
def test_a_sine_reads_its_peak_and_3_db_less_in_blocks_of_any_length(amplitude, size):
    meter = LevelMeter(RATE)
    signal = np.concatenate([sine(amplitude)] * 3)
    for start in range(0, len(signal), size):
        meter.add(signal[start : start + size])
    level_db = 20.0 * math.log10(amplitude)
    assert meter.level().peak_dbfs == pytest.approx(level_db, abs=0.2)
    assert meter.level().rms_dbfs == pytest.approx(level_db - 3.01, abs=0.05)


def test_one_channel_views_and_flat_blocks_read_alike():
    block = np.random.default_rng(1).standard_normal((1024, 2)).astype(np.float32)
    levels = set()
    for view in (block[:, 0], block[:, :1], block[:, 0].copy(), block[:, 0].copy()[:, None]):
        meter = LevelMeter(RATE)
        meter.add(view)
        levels.add((round(meter.level().peak_dbfs, 6), round(meter.level().rms_dbfs, 6)))
    assert len(levels) == 1


def test_silence_reads_the_floor_and_a_peak_falls_20_db_a_second():
    meter = LevelMeter(RATE)
    assert meter.level() == Level(FLOOR_DBFS, FLOOR_DBFS)
    meter.add(np.full((1, 1), -1.0, np.float32))
    meter.add(np.zeros((RATE, 1), np.float32))
    assert meter.level().peak_dbfs == pytest.approx(-20.0, abs=0.01)
    for _ in range(10):
        meter.add(np.zeros((RATE, 1), np.float32))
    assert meter.level() == Level(FLOOR_DBFS, FLOOR_DBFS)
    assert meter._reading == (0.0, 0.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite_spoil_nothing(value):
    meter = LevelMeter(RATE)
    meter.add(sine(0.5))
    before = meter.level()
    meter.add(np.array([[0.1], [value]], np.float32))
    assert meter.level() == before
    meter.add(np.full((64, 2), np.finfo(np.float32).max))
    assert math.isfinite(meter.level().rms_dbfs)


def test_an_empty_block_changes_nothing_and_a_reset_everything():
    meter = LevelMeter(RATE)
    meter.add(sine(0.5))
    before = meter.level()
    meter.add(np.zeros((0, 2), np.float32))
    assert meter.level() == before
    meter.reset()
    assert meter.level() == Level()


def growth(step) -> int:
    for _ in range(100):
        step()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(2000):
            step()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return after - before


def test_neither_meter_nor_clock_grows():
    meter, clock = LevelMeter(RATE), BufferClock()
    block = sine(0.5, 1024)
    assert growth(lambda: meter.add(block)) < 1000
    assert growth(lambda: clock.add(0.001, 0.02)) < 1000


# ------------------------------------------------------------------------- times per buffer


def test_before_the_first_buffer_all_times_are_0():
    assert BufferClock().times() == BufferTimes()


@given(st.lists(st.floats(2e-6, 9.0), min_size=1, max_size=300))
def test_percentiles_are_at_most_4_percent_too_long_and_never_too_short(durations_s):
    clock = BufferClock()
    for duration_s in durations_s:
        clock.add(duration_s, 0.02)
    ordered_ms = sorted(1e3 * duration_s for duration_s in durations_s)
    times = clock.times()
    assert times.max_ms == ordered_ms[-1]
    for share, reading_ms in ((0.5, times.p50_ms), (0.99, times.p99_ms)):
        exact_ms = ordered_ms[math.ceil(share * len(ordered_ms)) - 1]
        assert exact_ms * (1 - 1e-9) <= reading_ms <= exact_ms * STEP * (1 + 1e-9)
    assert times.p50_ms <= times.p99_ms <= times.max_ms


def test_the_share_is_of_all_time_played():
    clock = BufferClock()
    clock.add(0.001, 0.02)
    clock.add(0.003, 0.06)
    times = clock.times()
    assert times.share_percent == pytest.approx(5.0)
    assert times.buffer_ms == pytest.approx(60.0)


@pytest.mark.parametrize("duration_s", [-1.0, 0.0, 1e-9, 100.0, 1e9, math.inf])
def test_times_off_the_scale_are_taken_too(duration_s):
    clock = BufferClock()
    clock.add(duration_s, 0.0)
    times = clock.times()
    assert times.max_ms == max(0.0, 1e3 * duration_s)
    assert times.p50_ms == times.max_ms
    assert times.share_percent == 0.0


def test_each_channel_is_measured_by_itself():
    meter = LevelMeter(RATE)
    assert meter.channel_readings() == [(0.0, 0.0)]
    both = sine(0.5)
    both[:, 1] *= 0.1
    for block in np.array_split(both, 40):
        meter.add(block)
    (left, left_square), (right, right_square) = meter.channel_readings()
    assert (left, right) == pytest.approx((0.5, 0.05), rel=1e-3)
    assert left_square / right_square == pytest.approx(100.0, rel=1e-3)
    assert meter.reading()[0] == left
    meter.reset()
    assert meter.channel_readings() == [(0.0, 0.0)]


def test_the_histogram_counts_every_buffer_once_and_those_that_were_late():
    clock = BufferClock()
    for busy_s in (0.5e-4, 3e-4, 0.02, 0.3):
        clock.add(busy_s, 0.01)
    times = clock.times()
    assert times.counts == (1, 1, 2, 2, 2, 2, 2, 3, 3, 4)
    assert times.late == 2
    assert times.busy_s == pytest.approx(0.32035)

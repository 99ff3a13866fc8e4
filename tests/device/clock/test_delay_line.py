from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.clock import DelayLine, DelayState
from device.clock.delay_line import CubicReader, NewestFrames
from device.errors import UsageError
from device.units import Float32Array, FloatArray
from tests.support.clocks import Side, run
from tests.support.signals import best_sinusoid

MS = 0.001
BLOCK_S = 256 / 48_000
EXHAUSTIVE = pytest.mark.exhaustive


def two_clocks(ppm, jitter_s, seconds, rates=(48_000, 48_000), seed=0):
    writer = Side(rates[0], jitter_s=jitter_s, seed=2 * seed + 1)
    reader = Side(rates[1], ppm=ppm, jitter_s=jitter_s, start_s=0.003, seed=2 * seed + 2)
    return run(DelayLine(1, *rates), writer, reader, seconds)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("jitter_s", "excursion_s", "range_s"),
    [
        (2 * MS, 0.2 * MS, 0.13 * MS),
        (0.2 * MS, 0.05 * MS, 0.013 * MS),
        (0.0, 0.01 * MS, 0.002 * MS),
    ],
)
@pytest.mark.parametrize("ppm", [-300, 300])
def test_the_delay_stays_on_target_between_any_two_clocks(ppm, jitter_s, excursion_s, range_s):
    course = two_clocks(ppm, jitter_s, 45.0, seed=abs(ppm))
    assert course.last.state is DelayState.LOCKED
    assert (course.last.resyncs, course.last.underflows, course.last.overflows) == (0, 0, 0)
    assert np.abs(course.after(0.0)).max() < 0.6 * MS
    assert np.abs(course.after(15.0)).max() < excursion_s
    assert np.ptp(course.after(30.0)) < range_s
    assert course.ppm[course.time_s > 30].mean() == pytest.approx(-ppm, abs=0.2 + jitter_s * 5e3)


def test_it_plays_once_it_knows_both_sides_and_is_on_target_a_second_later():
    for seed in range(4):
        course = two_clocks(-300, 2 * MS, 8.0, seed=seed)
        assert np.abs(course.after(1.7)).max() < 0.44 * MS
        assert course.time_s[course.states.index(DelayState.LOCKED)] < 4.5
        assert course.time_s[course.states.index(DelayState.SETTLING)] < 0.75


@EXHAUSTIVE
def test_five_milliseconds_of_jitter_are_no_reason_to_leave_the_target():
    course = two_clocks(300, 5 * MS, 45.0)
    assert course.last.resyncs == 0
    assert course.last.underflows <= 1  # while the lateness is not yet known
    assert np.abs(course.after(15.0)).max() < 0.44 * MS


@pytest.mark.sweep
@pytest.mark.parametrize("rates", [(44_100, 48_000), (48_000, 44_100), (48_000, 8_000)])
def test_nominal_rates_may_differ(rates):
    course = two_clocks(150, 0.2 * MS, 30.0, rates)
    assert course.last.state is DelayState.LOCKED
    assert np.abs(course.after(12.0)).max() < 0.05 * MS
    assert course.last.underflows + course.last.resyncs == 0


JITTERY = Side(block=512, jitter_s=4 * MS)

BLOCKS: dict[str, Any] = {
    # options of the line, writer, reader; target, its tolerance and the largest error in seconds
    "bursts of four": (
        {},
        Side(burst=4),
        Side(burst=4, ppm=-300, start_s=0.003),
        # 1.5 + 1 blocks, and the three blocks that the first of a burst waits for the last
        ((2.5 + 3.0) * BLOCK_S, 0.8 * MS, 0.44 * MS),
    ),
    "twice as long as announced": (
        {},
        Side(block=512),
        Side(block=512, start_s=0.003),
        (1_152 / 48_000, 128 / 48_000, 0.05 * MS),
    ),
    "lateness and offset": (
        {"capture_block": 512, "output_block": 128, "offset_s": 0.02},
        JITTERY,
        # reads are never early: only late writes have to be provided for
        replace(JITTERY, block=128, start_s=0.003),
        (0.02 + 896 / 48_000 + 4 * MS, 0.7 * MS, 0.44 * MS),
    ),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_the_target_is_the_sum_of_blocks_lateness_and_offset_and_is_kept(name):
    options, writer, reader, (target_s, tolerance_s, limit_s) = BLOCKS[name]
    course = run(DelayLine(1, 48_000, 48_000, **options), writer, reader, 30.0)
    assert course.last.target_s == pytest.approx(target_s, abs=tolerance_s)
    assert course.last.delay_s == pytest.approx(course.last.target_s, abs=limit_s)
    assert np.abs(course.after(15.0)).max() < limit_s
    assert course.last.underflows <= 2  # while the lateness is not yet known


@EXHAUSTIVE
@pytest.mark.parametrize("server_block", [470, 511, 1_000])
def test_blocks_of_a_server_that_beat_with_ours_do_not_move_the_delay(server_block):
    line = DelayLine(1, 48_000, 48_000)
    writer = Side(server_block=server_block, ppm=-100, jitter_s=0.2 * MS)
    course = run(line, writer, Side(ppm=-250, jitter_s=0.2 * MS, start_s=0.003), 120.0)
    assert course.last.resyncs == 0
    assert course.last.underflows <= 1  # while the lateness is not yet known
    assert np.ptp(course.after(60.0)) < 0.3 * MS


@EXHAUSTIVE
@pytest.mark.parametrize(
    ("written_in", "read_in", "from_s", "limit_ms"),
    [(1_023, 0, 10.0, 0.5), (1_025, 0, 10.0, 0.3), (0, 1_025, 3.0, 1.5), (0, 1_023, 3.0, 1.5)],
)
def test_a_beat_that_is_learned_in_time_is_no_error(written_in, read_in, from_s, limit_ms):
    line = DelayLine(1, 48_000, 48_000, lateness_least_s=0.005)
    # Callbacks come a little earlier, or later, each time: it takes 22 s to have seen them all.
    writer = Side(server_block=written_in, jitter_s=0.2 * MS)
    reader = Side(server_block=read_in, ppm=-200, jitter_s=0.2 * MS, start_s=0.003)
    errors_ms: list[float] = []

    def note(now_s: float, line: DelayLine, out: Float32Array) -> None:
        status = line.status
        if now_s > from_s:
            errors_ms.append(1e3 * (status.delay_s - status.target_s))

    course = run(line, writer, reader, 60.0, note)
    assert course.last.resyncs == 0
    assert np.abs(errors_ms).max() < limit_ms
    assert course.last.state is DelayState.LOCKED


@pytest.mark.soak
@pytest.mark.parametrize(("hours", "ppm"), [(1.0, 300), (24.0, -300), (24.0, 300)])
def test_an_hour_or_a_day_at_300_ppm_gains_and_loses_nothing(hours, ppm):
    """Coarse blocks, 1024 frames at 8 kHz.

    24 times fewer callbacks a second average jitter sqrt(24) times worse: 0.4 ms is like 2 ms.
    """
    line = DelayLine(1, 8_000, 8_000, capture_block=1_024, output_block=1_024)
    writer = Side(samplerate=8_000, block=1_024, jitter_s=0.4 * MS, seed=1)
    reader = Side(samplerate=8_000, block=1_024, jitter_s=0.4 * MS, seed=2, ppm=ppm, start_s=0.05)
    course = run(line, writer, reader, hours * 3_600)
    assert course.last.state is DelayState.LOCKED
    assert course.last.resyncs + course.last.underflows + course.last.overflows == 0
    assert np.abs(course.after(60.0)).max() < 0.2 * MS


def heard(hz: float, ppm: float, jitter_s: float, samplerate_out: int, keep_s: float) -> FloatArray:
    """The last seconds of 25 that a sine comes out of a delay line."""
    line = DelayLine(1, 48_000, samplerate_out)
    writer = Side(jitter_s=jitter_s, seed=1).callbacks()
    reader = Side(samplerate_out, ppm=ppm, jitter_s=jitter_s, start_s=0.003, seed=2).callbacks()
    out = np.empty((256, 1), np.float32)
    parts = []
    write_s, read_s, written = next(writer)[0], next(reader)[0], 0
    while read_s < 25.0:
        if write_s <= read_s:
            turns = hz * (written + np.arange(256)) / 48_000 % 1.0
            line.write(0.9 * np.sin(2 * np.pi * turns)[:, np.newaxis], write_s)
            written += 256
            write_s = next(writer)[0]
        else:
            line.read(out, read_s)
            if read_s > 25.0 - keep_s:
                parts.append(out[:, 0].astype(np.float64))
            read_s = next(reader)[0]
    assert line.status.state is DelayState.LOCKED
    return np.concatenate(parts)


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate_out", [44_100, 48_000])
@pytest.mark.parametrize("hz", [20, 90, 250])
def test_a_sine_of_the_vibration_band_stays_a_sine(hz, samplerate_out):
    vibration = heard(hz, 150, 0.0, samplerate_out, 2.0)
    _, amplitude, rest_db = best_sinusoid(vibration, samplerate_out, hz)
    assert rest_db < -100
    assert amplitude == pytest.approx(0.9, rel=1e-5)


@pytest.mark.sweep
@pytest.mark.parametrize("hz", [250, 20])
def test_steering_under_jitter_adds_nothing_away_from_the_sine(hz):
    vibration = heard(hz, -300, 2 * MS, 48_000, 5.0)
    spectrum = np.abs(np.fft.rfft(vibration * np.kaiser(len(vibration), 20.0))) ** 2
    near = np.abs(np.fft.rfftfreq(len(vibration), 1 / 48_000) - hz) < 5
    assert 10 * np.log10(spectrum[~near].sum() / spectrum[near].sum()) < -110


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("capacity_s", 0.05), ("capacity_s", float("inf"))]
    + [("offset_s", wrong) for wrong in (-0.001, 5.0, float("nan"))],
)
def test_what_cannot_be_is_refused_when_it_is_made(name, wrong):
    options: dict[str, Any] = {name: wrong}
    with pytest.raises(UsageError, match=name):
        DelayLine(1, 48_000, 48_000, **options)


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.lists(st.integers(0, 1_300), max_size=12), st.floats(0.1, 3.0), st.integers(0, 2**45))
def test_blocks_of_any_length_join_to_the_same_frames_as_one(blocks, step, start):
    ring = np.random.default_rng(1).uniform(-1, 1, (4_096, 2)).astype(np.float32)
    whole, parts = CubicReader(ring), CubicReader(ring)
    whole.jump_to(start)
    parts.jump_to(start)
    expected = np.empty((sum(blocks), 2), np.float32)
    whole.read(expected, step)
    got, first = np.empty_like(expected), 0
    for frames in blocks:
        parts.read(got[first : first + frames], step)
        first += frames
    # Sums of 1300 steps are rounded in another order: a billionth of a frame.
    np.testing.assert_allclose(got, expected, atol=2e-6)
    assert (parts.position - start + parts.fraction) == pytest.approx(sum(blocks) * step, abs=1e-8)
    assert 0.0 <= parts.fraction < 1.0


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.integers(0, 3_000), st.floats(0.1, 3.0), st.floats(0.0, 0.999))
def test_readable_is_as_much_as_needs_no_frame_that_is_not_there(written, step, fraction):
    reader = CubicReader(np.zeros((4_096, 1), np.float32))
    reader.fraction = fraction
    frames = reader.readable(written, step)
    if frames:
        assert fraction + (frames - 1) * step < written - 2
    assert fraction + frames * step >= written - 2 - 1e-6


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.lists(st.integers(0, 500), max_size=10))
def test_the_ring_holds_the_newest_frames_whatever_the_blocks(blocks):
    ring, written = NewestFrames(128, 1), 0
    for frames in blocks:
        written = ring.store(np.arange(written, written + frames, dtype=np.float32)[:, np.newaxis])
    assert ring.claimed == written == sum(blocks)
    for frame in range(max(0, ring.oldest), written):
        assert ring.frames[frame % 128, 0] == frame


def test_the_ring_says_what_it_overwrites_before_it_does():
    class Watched(NewestFrames):
        claims: list[int]

        def __setattr__(self, name: str, value: object) -> None:
            if name == "claimed" and "claims" in self.__dict__:
                self.claims.append(int(self.frames.any()))
            super().__setattr__(name, value)

    ring = Watched(16, 1)
    ring.claims = []
    ring.store(np.ones((4, 1), np.float32))
    assert ring.claims == [0]


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300, -3e38])
def test_what_is_no_vibration_becomes_silence(wrong):
    ring = NewestFrames(8, 2)
    ring.store(np.array([[0.5, wrong], [wrong, -0.5]]))
    assert ring.frames[:2].tolist() == [[0.5, 0.0], [0.0, -0.5]]

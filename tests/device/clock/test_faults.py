import tracemalloc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.clock import DelayLine, DelayState
from device.clock.delay_line import HOLD_OFF_S
from device.errors import InternalError, UsageError
from device.units import Float32Array
from tests.support.clocks import Side, run

MS = 0.001
BLOCK_S = 256 / 48_000
EXHAUSTIVE = pytest.mark.exhaustive
EARLY = [(0.3, 5), *(pytest.param(at_s, 3, marks=EXHAUSTIVE) for at_s in (0.12, 5.0))]


def tone_line(seconds, act=None, missing=range(0), hz=60.0):
    """What is heard of a sine of 0.8, and the states; `act` calls, before the n-th read."""
    line, out = DelayLine(1, 48_000, 48_000), np.empty((256, 1), np.float32)
    heard, states = [], []
    at = np.arange(256)
    for number in range(round(seconds / BLOCK_S)):
        if number not in missing:  # what comes after a gap is the sine, continued
            line.write(0.8 * np.sin(2 * np.pi * hz * at / 48_000)[:, np.newaxis], number * BLOCK_S)
            at += 256
        if act and number in act:
            act[number](line)
        line.read(out, number * BLOCK_S + 0.001)
        heard.append(out[:, 0].astype(np.float64))
        states.append(line.status.state)
    return np.concatenate(heard), states


TAP, OUTPUT = Side(jitter_s=MS, seed=1), Side(ppm=150, jitter_s=MS, seed=2, start_s=0.003)
STOP = ((10.0, 12.0),)

FAULTS = {
    "the tap stops for two seconds": (replace(TAP, gaps=STOP), OUTPUT),
    "the tap hangs and delivers two seconds at once": (replace(TAP, pauses=STOP), OUTPUT),
    "the output stops for two seconds": (TAP, replace(OUTPUT, gaps=STOP)),
    "the output hangs and asks for two seconds at once": (TAP, replace(OUTPUT, pauses=STOP)),
    "both hang": (replace(TAP, pauses=((10.0, 10.5),)), replace(OUTPUT, pauses=((10.0, 10.5),))),
    "the tap loses 30 ms": (replace(TAP, gaps=((10.0, 10.03),)), OUTPUT),
    "the output loses 30 ms": (TAP, replace(OUTPUT, gaps=((10.0, 10.03),))),
    "the tap is late by 80 ms": (replace(TAP, pauses=((10.0, 10.08),)), OUTPUT),
    "the tap begins five seconds later": (replace(TAP, start_s=5.0), OUTPUT),
    "the output begins five seconds later": (TAP, replace(OUTPUT, start_s=5.0)),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", FAULTS)
def test_after_a_fault_it_is_back_on_target_and_no_delay_stays(name):
    course = run(DelayLine(1, 48_000, 48_000), *FAULTS[name], seconds=25.0)
    assert course.last.state is DelayState.LOCKED
    assert np.abs(course.after(22.0)).max() < 0.25 * MS
    # Blocks, and at most the lateness of some callbacks after the fault.
    assert 2.5 * BLOCK_S < course.last.target_s < 2.5 * BLOCK_S + 4 * MS
    assert course.last.underflows + course.last.resyncs + course.last.overflows <= 3
    since = {state for state, at_s in zip(course.states, course.time_s, strict=True) if at_s > 12.8}
    assert since <= {DelayState.SETTLING, DelayState.LOCKED}


@dataclass
class AsksEarly(Side):
    """Some callbacks come with the first of them, once: a server fills its buffers."""

    at_s: float = 0.3
    early: int = 5

    def callbacks(self) -> Iterator[tuple[float, float]]:
        first, early_s = round(self.at_s / BLOCK_S), 0.0
        for number, (now_s, true_s) in enumerate(super().callbacks()):
            if number == first:
                early_s = now_s
            yield (early_s if first <= number < first + self.early else now_s), true_s


@pytest.mark.parametrize(("at_s", "early"), EARLY)
def test_a_server_that_fills_its_buffers_late_does_not_leave_a_delay_that_nobody_sees(at_s, early):
    asks = AsksEarly(jitter_s=MS, seed=2, start_s=0.003, at_s=at_s, early=early)
    course = run(DelayLine(1, 48_000, 48_000), TAP, asks, 20.0)
    assert np.abs(course.after(at_s + 7.7)).max() < 0.0005
    usual = run(DelayLine(1, 48_000, 48_000), TAP, replace(OUTPUT, ppm=0.0), 20.0)
    assert course.last.target_s == pytest.approx(usual.last.target_s, abs=0.0015)


def test_frames_slept_through_are_an_overflow_and_what_was_left_before_a_stall_is_not_played():
    line = DelayLine(1, 48_000, 48_000, capacity_s=0.5)
    course = run(line, TAP, replace(OUTPUT, gaps=((10.0, 11.0),)), 12.0)
    assert (course.last.overflows, course.last.resyncs, course.last.underflows) == (1, 0, 0)
    line = DelayLine(1, 48_000, 48_000, offset_s=0.3)
    course = run(line, replace(TAP, gaps=((10.0, 11.0),)), OUTPUT, 13.0)
    silent = np.array([state is DelayState.STARVED for state in course.states])
    # From 0.3 s after the last frame until 0.3 s after the first new one.
    assert silent.sum() * BLOCK_S == pytest.approx(1.0, abs=0.02)
    assert course.time_s[silent][-1] == pytest.approx(11.31, abs=0.01)


def test_ten_stalls_leave_the_delay_that_the_first_one_left():
    gaps = tuple((10.0 + 4 * number, 10.5 + 4 * number) for number in range(10))
    tap, output = replace(TAP, gaps=gaps), replace(OUTPUT, ppm=-200)
    course = run(DelayLine(1, 48_000, 48_000), tap, output, 60.0)
    assert course.last.underflows == 10
    assert course.last.target_s < 2.5 * BLOCK_S + 2 * MS
    assert np.abs(course.after(55.0)).max() < 0.25 * MS


@pytest.mark.parametrize("hz", [60.0, *(pytest.param(n, marks=EXHAUSTIVE) for n in (20.0, 250.0))])
@pytest.mark.parametrize(
    ("act", "missing"),
    [(None, 40), (None, 1), (DelayLine.flush, 0), (lambda one: setattr(one, "offset_s", 0.05), 0)],
    ids=["starved", "one block missing", "flush", "jump"],
)
def test_nothing_clicks(act, missing, hz):
    heard, _ = tone_line(2.5, {200: act} if act else {}, range(200, 200 + missing), hz)
    assert np.abs(heard).max() <= 1.0
    # The largest change of slope from frame to frame; a hard step of 0.8 has 0.8.
    assert np.abs(np.diff(heard, 2)).max() < 0.006


def test_flush_fades_at_once_and_plays_nothing_that_was_written_before_it():
    heard, states = tone_line(2.0, {200: DelayLine.flush})
    at, fade, target = 200 * 256, 240, 640
    assert not heard[at + fade : at + target - 256].any()
    assert states[200] is DelayState.EMPTY
    assert states[-1] in (DelayState.SETTLING, DelayState.LOCKED)


def test_states_tell_the_story():
    assert DelayLine(1, 48_000, 48_000).status.state is DelayState.EMPTY
    _, states = tone_line(6.0, missing=range(500, 600))
    story = [state for last, state in zip([None, *states], states, strict=False) if state != last]
    playing = [DelayState.SETTLING, DelayState.LOCKED]
    assert story == [DelayState.FILLING, *playing, DelayState.STARVED, *playing]


def test_a_tap_that_delivers_half_of_what_it_should_is_mostly_silent_and_never_buzzes():
    line, out = DelayLine(1, 48_000, 48_000), np.empty((256, 1), np.float32)
    sounds, rng = [], np.random.default_rng(0)
    for number in range(4_000):
        if number % 2:
            line.write(rng.uniform(-1, 1, (256, 1)), number * BLOCK_S)
        line.read(out, number * BLOCK_S)
        sounds.append(out.any())
    assert np.diff(sounds, prepend=False).sum() < 2 * 1.5 * 4_000 * BLOCK_S  # begins and ends
    assert line.status.underflows < 1.5 * 4_000 * BLOCK_S


@pytest.mark.parametrize(("apart_blocks", "waits"), [(100, True), (300, False)])
def test_a_tap_that_runs_dry_twice_in_a_second_is_silent_for_a_while(apart_blocks, waits):
    _, states = tone_line(3_000 * BLOCK_S, missing=range(0, 3_000, apart_blocks))
    silences = [len(list(same)) for state, same in groupby(states) if state is DelayState.STARVED]
    assert len(silences) > 1
    expected_s = HOLD_OFF_S if waits else BLOCK_S
    assert max(silences) * BLOCK_S == pytest.approx(expected_s, abs=1.5 * BLOCK_S)


def test_a_user_offset_is_reached_at_once_and_kept():
    line = DelayLine(1, 48_000, 48_000)

    def later(time_s: float, line: DelayLine, _: Float32Array) -> None:
        line.offset_s = 0.1 if time_s > 10 else 0.0

    course = run(line, Side(), Side(start_s=0.003, ppm=100), 20.0, later)
    assert line.offset_s == 0.1
    assert course.last.resyncs == 0  # the user wished it
    assert course.last.delay_s == pytest.approx(0.1 + 2.5 * BLOCK_S + MS, abs=0.1 * MS)
    assert np.abs(course.after(10.1)).max() < 0.25 * MS
    with pytest.raises(UsageError, match="offset_s=-1"):
        line.offset_s = -1.0


numbers = st.floats(allow_nan=True, allow_infinity=True) | st.floats(0, 3)
calls = st.one_of(
    st.tuples(st.sampled_from(["write", "read"]), st.integers(0, 9_000), numbers),
    st.tuples(st.just("on"), st.integers(1, 60), st.floats(0.0, 0.02)),
    st.tuples(st.sampled_from(["flush", "offset"]), st.just(0), st.floats(0.0, 0.2)),
    st.tuples(st.just("spoilt"), st.integers(0, 600), numbers),
)
RATES = [(48_000, 48_000), (44_100, 48_000), (8_000, 192_000), (96_000, 8_000)]


@settings(max_examples=60)
@given(st.lists(calls, max_size=30), st.sampled_from(RATES))
def test_no_order_of_calls_sizes_and_times_raises_or_gives_what_is_not_finite(calls, rates):
    line, draw = DelayLine(2, *rates, capacity_s=0.6), np.random.default_rng(0)
    now_s = 0.0

    def read(frames: int, at_s: float) -> None:
        out = np.full((frames, 2), np.nan, np.float32)
        line.read(out, at_s)
        assert np.isfinite(out).all()
        status = line.status
        assert np.isfinite([status.target_s, status.delay_s, status.ratio_ppm]).all()
        assert 0.0 < status.target_s <= 0.6
        assert abs(status.ratio_ppm) <= 3_001  # the loop's limit and the target's own pace

    for kind, count, number in calls:
        if kind == "write":
            line.write(draw.uniform(-1, 1, (count, 2)), number)
        elif kind == "spoilt":
            line.write(np.full((count, 2), number), now_s)
        elif kind == "read":
            read(count, number)
        elif kind == "on":  # a while of ordinary life
            for _ in range(count):
                now_s += 256 / 48_000
                line.write(draw.uniform(-1, 1, (rates[0] * 256 // 48_000, 2)), now_s + number)
                read(rates[1] * 256 // 48_000, now_s)
        elif kind == "offset":
            line.offset_s = number
        else:
            line.flush()


@pytest.mark.parametrize("shape", [(256,), (256, 1), (256, 3), (2, 256)])
def test_blocks_of_another_shape_are_a_mistake_of_the_program(shape):
    line = DelayLine(2, 48_000, 48_000)
    for use in (line.write, line.read):
        with pytest.raises(InternalError, match="was expected"):
            use(np.zeros(shape, np.float32), 0.0)


@pytest.mark.exhaustive
def test_memory_does_not_grow():
    line, block = DelayLine(2, 48_000, 48_000), np.zeros((256, 2), np.float32)

    def live(first: int, blocks: int) -> None:
        for number in range(first, first + blocks):
            line.write(block, number * BLOCK_S)
            line.read(block, number * BLOCK_S + 0.001)

    live(0, 12_000)  # a minute of callbacks is kept
    tracemalloc.start()
    live(12_000, 500)
    before, _ = tracemalloc.get_traced_memory()
    live(12_500, 1_500)
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 4_096
    assert peak - before < 65_536


def test_two_threads_without_a_lock_hear_whole_frames_only():
    line, written = DelayLine(2, 48_000, 48_000), np.empty((64, 2), np.float32)
    written[:, 0] = np.linspace(-0.5, 0.5, 64)
    written[:, 1] = -written[:, 0]

    def write() -> None:
        for number in range(3_000):
            line.write(written, number * 64 / 48_000)

    out = np.empty((64, 2), np.float32)
    with ThreadPoolExecutor(1) as pool:
        writer = pool.submit(write)
        for number in range(3_000):
            line.read(out, number * 64 / 48_000)
            np.testing.assert_allclose(out[:, 0], -out[:, 1], atol=1e-6)
            line.status  # noqa: B018
        writer.result()

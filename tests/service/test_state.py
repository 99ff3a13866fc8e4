import math
import os
import socket
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.service import meters
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from audioflinger_hook.service.systemd import Notifier, Watchdog, watchdog_period_s

S = DaemonState


def keeper_in(state: DaemonState) -> StateKeeper:
    keeper = StateKeeper(0.0)
    if state is S.RECOVERING:
        keeper.enter(S.RUNNING, 0.0)
        keeper.recover(Cause.STALL, 0.0)
    elif state is not S.STARTING:
        keeper.enter(state, 0.0, "reason")
    return keeper


@pytest.mark.parametrize("before", S)
def test_a_state_that_is_entered_is_new_unless_it_was_the_state(before):
    keeper = keeper_in(before)
    assert keeper.enter(S.IDLE, 1.0, "reason") == (before is not S.IDLE)
    assert keeper.state is S.IDLE


@pytest.mark.parametrize("state", S)
def test_a_recovery_is_counted_in_every_state_and_entered_where_sound_played(state):
    keeper = keeper_in(state)
    before = keeper.report(0.0).recoveries[Cause.STALL]
    keeper.recover(Cause.STALL, 1.0)
    report = keeper.report(1.0)
    assert report.recoveries[Cause.STALL] == before + 1
    assert (report.state is S.RECOVERING) == (report.reason == "stall")
    assert (keeper.state is S.RECOVERING) == (state in (S.RUNNING, S.IDLE, S.RECOVERING))


def test_a_state_that_goes_on_keeps_its_start_and_takes_the_new_reason():
    keeper = StateKeeper(0.0)
    assert keeper.enter(S.WAITING_FOR_DEVICE, 1.0, "no sink:a")
    assert not keeper.enter(S.WAITING_FOR_DEVICE, 5.0, "no sink:b")
    report = keeper.report(6.0)
    assert (report.since_s, report.reason) == (5.0, "no sink:b")
    assert keeper.report(0.0).since_s == 0.0  # a clock that runs back


def test_a_report_does_not_change_and_its_reason_is_a_printable_line_of_bounded_length():
    keeper = StateKeeper(0.0)
    report = keeper.report(1.0)
    keeper.count(Cause.RESYNC)
    keeper.enter(S.STOPPING, 2.0)
    assert (report.recoveries[Cause.RESYNC], report.state) == (0, S.STARTING)
    with pytest.raises(TypeError):
        report.recoveries[Cause.RESYNC] = 1  # type: ignore[index]
    keeper.enter(S.WAITING_FOR_SERVER, 0.0, "\x1b[2J no\n server " + "x" * 10**6)
    reason = keeper.report(0.0).reason
    assert reason.startswith("?[2J no server xxx")
    assert len(reason) == 200


def test_waits_double_from_50_ms_to_2_s_and_begin_anew_after_a_success():
    backoff = Backoff(longest_s=2.0)
    assert backoff.wait_s(5.0) == 0.0
    assert [backoff.failed(100.0) for _ in range(8)] == [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    backoff.succeeded()
    assert (backoff.wait_s(100.0), backoff.failed(100.0)) == (0.0, 0.05)
    assert backoff.wait_s(100.01) == pytest.approx(0.04)
    assert backoff.wait_s(100.06) == 0.0


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.booleans()), max_size=60))
def test_no_wait_is_ever_longer_than_the_longest_whatever_the_clock_does(steps):
    backoff = Backoff(longest_s=2.0)
    for now_s, failed in steps:
        if failed:
            backoff.failed(now_s)
        assert 0.0 <= backoff.wait_s(now_s) <= 2.0


def test_the_period_is_read_from_the_environment_of_this_process_only():
    assert watchdog_period_s(7, {"WATCHDOG_USEC": "10000000"}) == 10.0
    assert watchdog_period_s(7, {"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "7"}) == 10.0
    assert watchdog_period_s(7, {"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "8"}) is None
    for text in ("", "0", "-5", "1.5", "x", "٣", "9" * 5000):
        assert watchdog_period_s(7, {"WATCHDOG_USEC": text}) is None
    assert Watchdog(None).check_s is None
    assert not Watchdog(None).due(1, S.RUNNING, 0.0)


def test_a_daemon_whose_sound_stands_still_is_not_fed_unless_it_has_reason_to_be_silent():
    watchdog = Watchdog(10.0)
    assert watchdog.due(1, S.RUNNING, 0.0)
    assert not any(watchdog.due(1, S.RUNNING, now_s) for now_s in range(1, 60))
    assert watchdog.due(2, S.RUNNING, 60.0)
    for state in set(S) - {S.RUNNING}:
        watchdog = Watchdog(10.0)
        fed_s = [now_s for now_s in range(60) if watchdog.due(0, state, now_s)]
        assert max(b - a for a, b in pairwise(fed_s)) <= 5.0, state


@given(st.floats(0.01, 1e4), st.lists(st.floats(0.0, 1.0), min_size=50, max_size=80))
def test_who_asks_as_often_as_told_feeds_within_half_the_period(period_s, steps):
    watchdog, now_s, fed_s = Watchdog(period_s), 0.0, [0.0]
    watchdog.due(0, S.RUNNING, 0.0)
    for buffers, step in enumerate(steps, 1):
        now_s += step * watchdog.check_s
        if watchdog.due(buffers, S.RUNNING, now_s):
            fed_s.append(now_s)
    fed_s.append(now_s)
    assert max([b - a for a, b in pairwise(fed_s)]) <= period_s / 2 * (1 + 1e-9)


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    folder = os.open(tmp_path, os.O_PATH)  # pytest's folders may be deeper than an address is long
    path, abstract = f"/proc/self/fd/{folder}/notify", f"@{tmp_path.name}-{os.getpid()}"
    given = path if request.param == "path" else abstract
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(given.replace("@", "\0"))
        end.settimeout(5.0)
        yield end, given
    os.close(folder)


def test_every_message_arrives_as_systemd_reads_it(manager):
    end, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name})
    sent = [
        (("READY=1",), "running", b"READY=1\nSTATUS=running"),
        ((), "waiting-for-device", b"STATUS=waiting-for-device"),
        (("RELOADING=1", "MONOTONIC_USEC=12"), "", b"RELOADING=1\nMONOTONIC_USEC=12"),
        (("WATCHDOG=1",), "", b"WATCHDOG=1"),
    ]
    for assignments, status, message in sent:
        assert notifier.send(*assignments, status=status)
        assert end.recv(4096) == message
    notifier.send(status="no sink\nMAINPID=1\udc80")  # nor another assignment
    assert end.recv(4096) == b"STATUS=no sink MAINPID=1?"


@pytest.mark.parametrize(
    "name",
    [
        *("", "@", "/", "relative", "vsock:2:1234"),
        *("/no/such/socket", "@no-such-socket", "/" + "x" * 300, "/a\0b"),
    ],
)
def test_without_a_manager_or_with_one_that_is_gone_nothing_is_sent(name):
    assert not Notifier({"NOTIFY_SOCKET": name} if name else {}).send("READY=1")


def test_a_manager_that_reads_nothing_is_not_waited_for_long(manager):
    _, name = manager
    notifier, sent = Notifier({"NOTIFY_SOCKET": name}), 0
    while notifier.send(status="x" * 200):
        sent += 1
        assert sent < 100_000


RATE = 48_000


def sine(amplitude: float, frames: int = RATE, channels: int = 2) -> np.ndarray:
    phase = 2.0 * np.pi * 1000.0 * np.arange(frames) / RATE
    return np.repeat(amplitude * np.sin(phase)[:, None], channels, 1).astype(np.float32)


@pytest.mark.parametrize("amplitude", [1.0, 0.1, 1e-4])
@pytest.mark.parametrize("size", [64, 441, 1024, 9000])
def test_a_sine_reads_its_peak_and_3_db_less_in_blocks_of_any_length(amplitude, size):
    meter, signal = meters.LevelMeter(RATE), np.concatenate([sine(amplitude)] * 3)
    for start in range(0, len(signal), size):
        meter.add(signal[start : start + size])
    level_db = 20.0 * math.log10(amplitude)
    assert meter.level().peak_dbfs == pytest.approx(level_db, abs=0.2)
    assert meter.level().rms_dbfs == pytest.approx(level_db - 3.01, abs=0.05)


def test_silence_reads_the_floor_and_a_peak_falls_20_db_a_second():
    meter = meters.LevelMeter(RATE)
    assert meter.level() == meters.Level(meters.FLOOR_DBFS, meters.FLOOR_DBFS)
    meter.add(np.full((1, 1), -1.0, np.float32))
    meter.add(np.zeros((RATE, 1), np.float32))
    assert meter.level().peak_dbfs == pytest.approx(-20.0, abs=0.01)
    for _ in range(10):
        meter.add(np.zeros((RATE, 1), np.float32))
    assert meter.level() == meters.Level(meters.FLOOR_DBFS, meters.FLOOR_DBFS)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite_spoil_nothing(value):
    meter = meters.LevelMeter(RATE)
    meter.add(sine(0.5))
    before = meter.level()
    meter.add(np.array([[0.1], [value]], np.float32))
    meter.add(np.zeros((0, 2), np.float32))
    assert meter.level() == before
    meter.add(np.full((64, 2), np.finfo(np.float32).max))
    assert math.isfinite(meter.level().rms_dbfs)


def test_neither_meter_nor_clock_grows():
    meter, clock, block = meters.LevelMeter(RATE), meters.BufferClock(), sine(0.5, 1024)

    def held() -> int:
        for _ in range(2_000):
            meter.add(block)
            clock.add(0.001, 0.02)
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    before, after = held(), held()
    tracemalloc.stop()
    assert after - before < 1000


@given(st.lists(st.floats(2e-6, 9.0), min_size=1, max_size=300))
def test_percentiles_are_at_most_4_percent_too_long_and_never_too_short(durations_s):
    clock = meters.BufferClock()
    for duration_s in durations_s:
        clock.add(duration_s, 0.02)
    ordered_ms = sorted(1e3 * duration_s for duration_s in durations_s)
    times = clock.times()
    assert times.max_ms == ordered_ms[-1]
    for share, reading_ms in ((0.5, times.p50_ms), (0.99, times.p99_ms)):
        exact_ms = ordered_ms[math.ceil(share * len(ordered_ms)) - 1]
        assert exact_ms * (1 - 1e-9) <= reading_ms <= exact_ms * meters.STEP * (1 + 1e-9)
    assert times.p50_ms <= times.p99_ms <= times.max_ms


def test_times_off_the_scale_are_taken_too():
    for duration_s in (-1.0, 0.0, 1e-9, 100.0, 1e9, math.inf):
        clock = meters.BufferClock()
        clock.add(duration_s, 0.0)
        times = clock.times()
        assert (times.max_ms, times.p50_ms) == (max(0.0, 1e3 * duration_s), times.max_ms)
        assert times.share_percent == 0.0


def test_each_channel_is_measured_by_itself():
    meter = meters.LevelMeter(RATE)
    assert meter.channel_readings() == [(0.0, 0.0)]
    both = sine(0.5)
    both[:, 1] *= 0.1
    for block in np.array_split(both, 40):
        meter.add(block)
    (left, left_square), (right, right_square) = meter.channel_readings()
    assert (left, right) == pytest.approx((0.5, 0.05), rel=1e-3)
    assert left_square / right_square == pytest.approx(100.0, rel=1e-3)
    assert meter.reading()[0] == left
    for view in (both[:, :1], both[:, 0], both[:, 0].copy()):
        alone = meters.LevelMeter(RATE)
        for block in np.array_split(view, 40):
            alone.add(block)
        assert alone.reading() == pytest.approx((left, left_square))
    meter.reset()
    assert (meter.level(), meter.channel_readings()) == (meters.Level(), [(0.0, 0.0)])


def test_the_share_is_of_all_time_played_and_every_buffer_is_counted_once_and_if_late():
    clock = meters.BufferClock()
    assert clock.times() == meters.BufferTimes()
    clock.add(0.001, 0.02)
    clock.add(0.003, 0.06)
    times = clock.times()
    assert (times.share_percent, times.buffer_ms) == pytest.approx((5.0, 60.0))
    clock = meters.BufferClock()
    for busy_s in (0.5e-4, 3e-4, 0.02, 0.3):
        clock.add(busy_s, 0.01)
    times = clock.times()
    assert (times.counts, times.late) == ((1, 1, 2, 2, 2, 2, 2, 3, 3, 4), 2)
    assert times.busy_s == pytest.approx(0.32035)

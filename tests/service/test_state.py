"""States, recoveries, back-off and watchdog: decisions, with time as an argument."""

from __future__ import annotations

import sys
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from audioflinger_hook.service.systemd import Watchdog, watchdog_period_s

S = DaemonState


def keeper_in(state: DaemonState) -> StateKeeper:
    keeper = StateKeeper(0.0)
    if state is S.RECOVERING:
        keeper.enter(S.RUNNING, 0.0)
        keeper.recover(Cause.STALL, 0.0)
    elif state is not S.STARTING:
        keeper.enter(state, 0.0, "reason")
    return keeper


def test_the_states_are_shown_under_their_names():
    assert [state.value for state in S] == [
        "starting",
        "waiting-for-server",
        "waiting-for-device",
        "waiting-for-sound-source",
        "running",
        "idle",
        "recovering",
        "stopping",
    ]


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
    assert keeper.report(1.0).recoveries[Cause.STALL] == before + 1
    assert (keeper.state is S.RECOVERING) == (state in (S.RUNNING, S.IDLE, S.RECOVERING))


def test_a_recovery_without_a_reason_is_named_by_its_cause():
    keeper = keeper_in(S.RUNNING)
    keeper.recover(Cause.TAP_MOVED, 2.0)
    assert keeper.report(2.0).reason == "tap-moved"


def test_a_state_that_goes_on_keeps_its_start_and_takes_the_new_reason():
    keeper = StateKeeper(0.0)
    assert keeper.enter(S.WAITING_FOR_DEVICE, 1.0, "no sink:a")
    assert not keeper.enter(S.WAITING_FOR_DEVICE, 5.0, "no sink:b")
    report = keeper.report(6.0)
    assert (report.since_s, report.reason) == (5.0, "no sink:b")


def test_a_clock_that_runs_back_counts_as_standing_still():
    keeper = StateKeeper(10.0)
    keeper.enter(S.RUNNING, 12.0)
    assert keeper.report(0.0).since_s == 0.0


def test_a_report_is_a_picture_that_does_not_change():
    keeper = StateKeeper(0.0)
    report = keeper.report(1.0)
    keeper.count(Cause.RESYNC)
    keeper.enter(S.STOPPING, 2.0)
    assert report.recoveries[Cause.RESYNC] == 0
    assert report.state is S.STARTING
    with pytest.raises(TypeError):
        report.recoveries[Cause.RESYNC] = 1  # type: ignore[index]


def test_a_reason_becomes_one_printable_line_of_bounded_length():
    keeper = StateKeeper(0.0)
    keeper.enter(S.WAITING_FOR_SERVER, 0.0, "\x1b[2J no\n server " + "x" * 10**6)
    reason = keeper.report(0.0).reason
    assert reason.startswith("?[2J no server xxx")
    assert len(reason) == 200


def test_the_memory_of_the_keeper_does_not_grow():
    keeper = StateKeeper(0.0)

    def size() -> int:
        return sum(map(sys.getsizeof, (keeper._counts, keeper._current, keeper.__dict__)))

    keeper.enter(S.RUNNING, 0.0)
    before = size()
    for i in range(10_000):
        keeper.recover(Cause.STALL, i)
        keeper.enter(S.RUNNING, i + 0.5)
    assert size() == before


# --------------------------------------------------------------------------------- back-off


def test_waits_double_from_50_ms_to_2_s_and_begin_anew_after_a_success():
    backoff = Backoff(longest_s=2.0)
    waits = [backoff.failed(100.0) for _ in range(8)]
    assert waits == [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    backoff.succeeded()
    assert backoff.wait_s(100.0) == 0.0
    assert backoff.failed(100.0) == 0.05


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.booleans()), max_size=60))
def test_no_wait_is_ever_longer_than_the_longest_whatever_the_clock_does(steps):
    backoff = Backoff(longest_s=2.0)
    for now_s, failed in steps:
        if failed:
            backoff.failed(now_s)
        assert 0.0 <= backoff.wait_s(now_s) <= 2.0


def test_a_wait_is_over_when_its_time_has_passed():
    backoff = Backoff(longest_s=2.0)
    assert backoff.wait_s(5.0) == 0.0
    backoff.failed(5.0)
    assert backoff.wait_s(5.01) == pytest.approx(0.04)
    assert backoff.wait_s(5.06) == 0.0


# --------------------------------------------------------------------------------- watchdog


def test_the_period_is_read_from_the_environment_of_this_process_only():
    assert watchdog_period_s(7, {"WATCHDOG_USEC": "10000000"}) == 10.0
    assert watchdog_period_s(7, {"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "7"}) == 10.0
    assert watchdog_period_s(7, {"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "8"}) is None
    for text in ("", "0", "-5", "1.5", "x", "٣", "9" * 5000):
        assert watchdog_period_s(7, {"WATCHDOG_USEC": text}) is None


def test_a_daemon_whose_sound_stands_still_is_not_fed():
    watchdog = Watchdog(10.0)
    assert watchdog.due(1, S.RUNNING, 0.0)
    assert not any(watchdog.due(1, S.RUNNING, now_s) for now_s in range(1, 60))
    assert watchdog.due(2, S.RUNNING, 60.0)


@pytest.mark.parametrize("state", sorted(set(S) - {S.RUNNING}, key=str))
def test_a_daemon_that_has_reason_to_be_silent_is_fed(state):
    watchdog = Watchdog(10.0)
    fed_s = [now_s for now_s in range(60) if watchdog.due(0, state, now_s)]
    assert max(b - a for a, b in pairwise(fed_s)) <= 5.0


@given(st.floats(0.01, 1e4), st.lists(st.floats(0.0, 1.0), min_size=50, max_size=80))
def test_who_asks_as_often_as_told_feeds_within_half_the_period(period_s, steps):
    watchdog = Watchdog(period_s)
    assert watchdog.check_s is not None
    now_s, fed_s = 0.0, [0.0]
    watchdog.due(0, S.RUNNING, 0.0)
    for buffers, step in enumerate(steps, 1):
        now_s += step * watchdog.check_s
        if watchdog.due(buffers, S.RUNNING, now_s):
            fed_s.append(now_s)
    fed_s.append(now_s)
    gaps = [b - a for a, b in pairwise(fed_s)]
    assert max(gaps) <= period_s / 2 * (1 + 1e-9)


def test_without_a_watchdog_nothing_is_fed():
    assert Watchdog(None).check_s is None
    assert not Watchdog(None).due(1, S.RUNNING, 0.0)

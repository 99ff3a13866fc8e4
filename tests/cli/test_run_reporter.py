import json
import time
from unittest.mock import Mock

import pytest

from audioflinger_hook.cli import status
from audioflinger_hook.cli.run_reporter import AT_ONCE, EVERY_S, KINDS_MAX, RateLimit, RunReporter
from audioflinger_hook.service.state import NOTES_MAX, Cause, DaemonState, Note, StateKeeper
from device.errors import UsageError
from tests.service.test_status_server import STATUS
from tests.support.commands import call


@pytest.fixture(autouse=True)
def no_manager(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)


class Told:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys
        self.keeper = StateKeeper(0.0)
        self.reporter = RunReporter()

    def lines(self, now_s: float = 0.0, *warnings: str) -> list[str]:
        self.reporter.report(self.keeper.report(now_s), self.keeper.notes(), list(warnings), now_s)
        return self._capsys.readouterr().err.splitlines()


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Told:
    told = Told(capsys)
    told.keeper.enter(DaemonState.RUNNING, 0.0)
    told.lines()
    return told


def test_the_first_line_says_what_is_felt_and_where(told, capsys):
    told.reporter.begin("default", "sink:seat")
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "cushion: sound of default drives sink:seat; Ctrl+C ends it"


def test_a_state_is_told_once_and_again_with_another_reason(told: Told) -> None:
    for reason in ("no a", "no b"):
        told.keeper.enter(DaemonState.WAITING_FOR_DEVICE, 0.0, reason)
        assert told.lines() == [f"cushion: waiting-for-device: {reason}"]
        assert told.lines() == []


def test_what_was_over_within_one_look_is_told_all_the_same(told: Told) -> None:
    told.keeper.recover(Cause.TAP_LOST, 1.0, "the tap stopped")
    told.keeper.count(Cause.DEFAULT_CHANGED, "the tap moves to b")
    told.keeper.enter(DaemonState.RUNNING, 1.0)
    lines = ["tap-lost: the tap stopped", "default-changed: the tap moves to b"]
    assert told.lines(1.0) == [f"cushion: {line}" for line in lines]
    assert told.lines(1.0) == []


def test_what_the_state_says_is_not_said_twice(told: Told) -> None:
    told.keeper.recover(Cause.DEVICE_LOST, 1.0, "it stopped")
    assert told.lines(1.0) == ["cushion: recovering: it stopped"]
    told.keeper.recover(Cause.DEVICE_LOST, 2.0, "it stopped")
    assert told.lines(2.0) == ["cushion: device-lost: it stopped"]


def test_a_flood_becomes_a_few_lines_and_a_count(told: Told) -> None:
    said = []
    for tick in range(1_000):
        told.keeper.count(Cause.RESYNC, "processing fell behind; delay reset")
        said += told.lines(0.05 * tick)
    assert AT_ONCE + 3 <= len(said) <= AT_ONCE + 1_000 * 0.05 / EVERY_S + 1
    assert said[0] == "cushion: resync: processing fell behind; delay reset"
    assert "more like it before)" in said[-1]
    told.keeper.count(Cause.STALL, "a pause")
    assert told.lines(50.0) == ["cushion: stall: a pause"]


def test_the_notes_are_few_and_each_is_handed_out_once() -> None:
    keeper = StateKeeper(0.0)
    for number in range(1_000):
        keeper.count(Cause.RESYNC, str(number))
    notes = keeper.notes()
    assert (notes[-1], len(notes), keeper.notes()) == (Note(Cause.RESYNC, "999"), NOTES_MAX, [])
    keeper.count(Cause.STALL)
    assert keeper.notes() == [Note(Cause.STALL, "stall")]


def test_a_warning_is_told_when_it_comes_and_not_again_while_it_lasts(told: Told) -> None:
    assert told.lines(0.0, "a")[-1] == "cushion: warning: a"
    assert told.lines(0.0, "a", "b") == ["cushion: warning: b"]
    assert told.lines(0.0, "b") == []
    assert told.lines(0.0, "a", "b") == ["cushion: warning: a"]


def test_a_warning_that_counts_is_told_when_it_begins_and_with_its_sum_at_the_end(told, capsys):
    said = [line for count in range(1, 100) for line in told.lines(0.0, f"{count} lost", "a")]
    assert said == ["cushion: warning: 1 lost", "cushion: warning: a"]
    told.reporter.end(["99 lost", "a", "b"])
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["cushion: warning: 99 lost", "cushion: warning: b"]


def test_a_config_that_is_not_taken_is_told_at_every_attempt(told: Told) -> None:
    def fail() -> str:
        raise UsageError("line 1: it is wrong")

    for _ in range(2):
        trouble = told.reporter.reload(fail, 0.0)
        assert trouble == "the config was not applied: line 1: it is wrong"
        assert told.lines(0.0, trouble) == [f"cushion: warning: {trouble}"]
    assert told.reporter.reload(lambda: "the level", 0.0) == ""
    assert told.lines() == ["cushion: config reloaded; changed: the level"]


def test_of_each_kind_some_are_allowed_at_once_and_then_one_now_and_then() -> None:
    ration = RateLimit(2)
    assert [ration.left_out("a", now_s) for now_s in (0.0, 0.0, 1.0, 2.0)] == [0, 0, None, None]
    assert ration.left_out("b", 2.0) == 0
    assert ration.left_out("a", 11.0) == 2
    assert ration.left_out("a", 12.0) is None
    # A clock that runs back gives nothing.
    assert ration.left_out("a", 0.0) is None
    assert ration.left_out("a", 1_000.0) == 2
    assert [ration.left_out("a", 1_000.0) for _ in range(2)] == [0, None]


def test_kinds_without_end_take_no_memory_without_end() -> None:
    ration = RateLimit()
    said = [ration.left_out(kind, 0.0) is not None for kind in range(10 * KINDS_MAX)]
    assert all(said[:KINDS_MAX])
    assert sum(said) <= KINDS_MAX + AT_ONCE


def test_watched_json_is_one_line_each_second_until_it_is_interrupted(monkeypatch):
    monkeypatch.setattr(status, "ask_status", lambda *_: STATUS)
    sleeps = Mock(side_effect=[None, None, KeyboardInterrupt])
    monkeypatch.setattr(status, "time", Mock(monotonic=time.monotonic, sleep=sleeps))
    lines = call("status", "--watch", "--json").stdout.splitlines()
    assert len(lines) == 3
    assert {json.loads(line)["state"] for line in lines} == {STATUS.state.value}
    assert [one.args for one in sleeps.call_args_list] == [(status.JSON_EVERY_S,)] * 3
    assert len(call("status", "--json").stdout.splitlines()) == 1

"""When a connection's default devices are compared with those that a new connection reports."""

import time

import numpy as np
import pytest

from device.server import defaults_check
from device.server.defaults_check import Defaults, DefaultsCheck
from tests.support.snapshots import snapshot


def due_s(*changes_s: float, kind: str = "PipeWire") -> float | None:
    check = DefaultsCheck(lambda known: None)
    for now_s in changes_s:
        check.note_change(float(now_s), snapshot(kind=kind))
    return check.due_s


def test_the_check_waits_for_calm_but_not_for_ever_and_pulseaudio_needs_none():
    assert due_s(10.0, kind="PulseAudio") is None
    assert due_s(10.0, 10.5, 11.0) == 11.0 + defaults_check.AFTER_S
    assert due_s(*np.arange(10.0, 30.0, 0.1)) == 10.0 + defaults_check.AT_MOST_S


KNOWN, NEW, NEWER = Defaults("desktop", ""), Defaults("speakers", ""), Defaults("hdmi", "")


@pytest.fixture
def checked(monkeypatch):
    """Checks against these answers of new connections, and what was reported."""
    monkeypatch.setattr(defaults_check, "AGAIN_S", 0.0)
    reported: list[Defaults] = []
    check = DefaultsCheck(reported.append)

    def run(*answers: Defaults | None) -> tuple[int, float]:
        """How often outdated defaults were reported, and in how many s they may be again."""
        left = iter(answers)
        monkeypatch.setattr(defaults_check, "fetch_defaults", lambda: next(left))
        check.check(KNOWN)
        check.note_change(now_s := time.monotonic(), snapshot(kind="PipeWire"))
        assert check.due_s is not None
        again_s, check.due_s = check.due_s - now_s, None
        return len(reported), again_s

    return run


def test_two_new_connections_that_agree_outdate_the_known_defaults(checked):
    assert (checked(KNOWN)[0], checked(NEW, NEW)[0]) == (0, 1)


def test_a_change_in_progress_or_a_server_without_an_answer_is_asked_again(checked):
    assert checked(None, NEW, NEWER, NEWER, NEWER)[0] == 1
    assert checked(NEW, None, KNOWN)[0] == 1  # none more


def test_outdated_defaults_are_reported_soon_but_ever_less_often_where_that_does_not_help(checked):
    waits_s = [checked(NEW, NEW)[1] for _ in range(6)]
    again_s, most_s = defaults_check.RENEW_AGAIN_S, defaults_check.RENEW_AT_MOST_S
    wanted_s = [min(again_s * 2.0**number, most_s) for number in range(6)]
    assert waits_s == pytest.approx(wanted_s, abs=0.5)
    checked(KNOWN)
    assert checked(NEW, NEW)[1] == pytest.approx(again_s, abs=0.5)

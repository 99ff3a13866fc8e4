"""When a connection's default devices are compared with those that a new connection reports."""

import numpy as np

from device.server.defaults_check import AFTER_S, AT_MOST_S, DefaultsCheck
from tests.support.snapshots import snapshot


def due_s(*changes_s: float, kind: str = "PipeWire") -> float | None:
    check = DefaultsCheck(lambda known: None)
    for now_s in changes_s:
        check.note_change(float(now_s), snapshot(kind=kind))
    return check.due_s


def test_the_check_waits_for_calm_but_not_for_ever():
    assert due_s(10.0, 10.5, 11.0) == 11.0 + AFTER_S
    assert due_s(*np.arange(10.0, 30.0, 0.1)) == 10.0 + AT_MOST_S


def test_pulseaudio_needs_no_check():
    assert due_s(10.0, kind="PulseAudio") is None

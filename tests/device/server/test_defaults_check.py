"""When a connection's default devices are compared with those that a new connection reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from device.server.defaults_check import AFTER_S, AT_MOST_S, DefaultsCheck
from device.server.snapshot import ServerSnapshot

NOTHING = ServerSnapshot("PipeWire", "1.4.2", "", "", (), (), (), (), 0)


def test_the_check_waits_for_calm():
    check = DefaultsCheck(lambda known: None)
    for now_s in (10.0, 10.5, 11.0):
        check.note_change(now_s, NOTHING)
    assert check.due_s == 11.0 + AFTER_S


def test_changes_without_end_do_not_put_the_check_off_for_ever():
    check = DefaultsCheck(lambda known: None)
    for now_s in np.arange(10.0, 30.0, 0.1):
        check.note_change(float(now_s), NOTHING)
    assert check.due_s == 10.0 + AT_MOST_S


def test_pulseaudio_needs_no_check():
    check = DefaultsCheck(lambda known: None)
    check.note_change(10.0, replace(NOTHING, kind="PulseAudio"))
    assert check.due_s is None

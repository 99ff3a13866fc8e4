"""Functions are called in processes of their own, which may fail, die or hang."""

from __future__ import annotations

import os
import sys
import time

import pytest

from device.errors import LostError, UsageError
from device.process import LIMIT_S, Call
from tests.support.commands import open_files


def large(share: bytes) -> bytes:
    return share * 1_000_000


def refuse() -> None:
    raise UsageError("no such rig")


def fail() -> None:
    raise ZeroDivisionError


def over(call: Call[object]) -> Call[object]:
    deadline_s = time.monotonic() + 20.0
    while not call.is_over(time.monotonic()):
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    return call


def test_a_call_returns_what_the_function_does_in_another_process() -> None:
    assert over(Call("it", time.monotonic(), large, b"cushion")).result() == large(b"cushion")
    assert over(Call("it", time.monotonic(), os.getppid)).result() == os.getpid()
    assert over(Call("it", time.monotonic(), os.getpid)).result() != os.getpid()


def test_a_users_mistake_comes_back_and_other_errors_are_one_line(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(UsageError, match="no such rig"):
        over(Call("it", time.monotonic(), refuse)).result()
    with pytest.raises(LostError, match=r"^damping cannot be computed: ZeroDivisionError:"):
        over(Call("damping", time.monotonic(), fail)).result()
    with pytest.raises(LostError, match=r"the process failed \(3\)"):
        over(Call("damping", time.monotonic(), os._exit, 3)).result()
    assert capfd.readouterr() == ("", "")


def test_a_call_that_hangs_is_ended() -> None:
    call = Call("damping", 5.0, time.sleep, 60.0)
    assert not call.is_over(5.0 + LIMIT_S)
    assert call.is_over(5.1 + LIMIT_S)
    with pytest.raises(LostError, match=r"damping cannot be computed: the process took over 30 s"):
        call.result()


def test_a_call_that_is_closed_leaves_nothing() -> None:
    before = open_files()
    call = Call("it", time.monotonic(), time.sleep, 60.0)
    for _ in range(2):
        call.close()
    assert call._process.returncode == -9
    assert open_files() == before


def test_without_python_a_call_cannot_start(monkeypatch: pytest.MonkeyPatch) -> None:
    before = open_files()
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(LostError, match=r"damping cannot be computed: .*No such file"):
        Call("damping", time.monotonic(), os.getpid)
    assert open_files() == before

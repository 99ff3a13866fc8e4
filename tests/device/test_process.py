import os
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from device.errors import LostError, UsageError
from device.process import LIMIT_S, Call
from tests.support.alsa_files import until
from tests.support.commands import open_files


def large(share: bytes) -> bytes:
    return share * 1_000_000


def refuse() -> None:
    raise UsageError("no such rig")


def fail() -> None:
    raise ZeroDivisionError


def result(function: Callable[..., object], *arguments: object) -> object:
    call = Call("damping", time.monotonic(), function, *arguments)
    until(lambda: call.is_over(time.monotonic()), 20.0)
    return call.result()


def test_a_call_returns_what_the_function_does_in_another_process():
    assert (result(large, b"cushion"), result(os.getppid)) == (large(b"cushion"), os.getpid())
    assert result(os.getpid) != os.getpid()


def test_a_users_mistake_comes_back_and_other_errors_are_one_line(capfd):
    with pytest.raises(UsageError, match="no such rig"):
        result(refuse)
    with pytest.raises(LostError, match=r"^damping cannot be computed: ZeroDivisionError:"):
        result(fail)
    with pytest.raises(LostError, match=r"the process failed \(3\)"):
        result(os._exit, 3)
    assert capfd.readouterr() == ("", "")


def test_a_call_that_hangs_is_ended_and_one_that_is_closed_leaves_nothing():
    call = Call("damping", 5.0, time.sleep, 60.0)
    assert not call.is_over(5.0 + LIMIT_S)
    assert call.is_over(5.1 + LIMIT_S)
    with pytest.raises(LostError, match=r"damping cannot be computed: the process took over 30 s"):
        call.result()
    before, call = open_files(), Call("it", time.monotonic(), time.sleep, 60.0)
    for _ in range(2):
        call.close()
    assert (call._process.returncode, open_files()) == (-9, before)


def test_without_python_a_call_cannot_start(monkeypatch):
    before = open_files()
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(LostError, match=r"damping cannot be computed: .*No such file"):
        Call("damping", time.monotonic(), os.getpid)
    assert open_files() == before


PROGRAM = """
import os, signal, sys, time
from device.whole_process import repeat_lost_interruptions

class Slow:
    def __del__(self):
        {destructor}

def interrupted(number, frame):
    raise KeyboardInterrupt

signal.signal(signal.SIGTERM, interrupted)
repeat_lost_interruptions()
try:
    for _ in range({times}):
        Slow()
    time.sleep(60)
except KeyboardInterrupt:
    print("interrupted")
"""


def run(destructor, times=1):
    command = [sys.executable, "-c", PROGRAM.format(destructor=destructor, times=times)]
    return subprocess.run(command, capture_output=True, text=True, timeout=30)


@pytest.mark.parametrize("times", [1, 3])
def test_an_interruption_in_a_destructor_comes_after_it_and_is_not_printed(times):
    done = run("os.kill(os.getpid(), signal.SIGTERM)", times)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


def test_other_exceptions_of_a_destructor_are_reported_as_before():
    done = run("signal.alarm(1); 1 / 0")
    assert done.stdout == "interrupted\n"
    assert "Exception ignored in" in done.stderr
    assert "ZeroDivisionError" in done.stderr

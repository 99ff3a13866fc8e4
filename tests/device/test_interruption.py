"""Interruptions that arrive in a destructor are neither lost nor printed."""

import subprocess
import sys

import pytest

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

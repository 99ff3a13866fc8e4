"""Whether a process has real-time priority is read from the kernel."""

from __future__ import annotations

import os
import subprocess

import pytest

from audioflinger_hook.daemon.native.chain import has_realtime


def test_a_process_has_real_time_priority_once_one_of_its_threads_has_it() -> None:
    with subprocess.Popen(["sleep", "60"]) as process:
        try:
            assert not has_realtime(process.pid)
            try:
                os.sched_setscheduler(process.pid, os.SCHED_RR, os.sched_param(1))
            except PermissionError:
                pytest.skip("this user may not give real-time priority")
            assert has_realtime(process.pid)
        finally:
            process.kill()
    assert not has_realtime(process.pid)  # it has ended

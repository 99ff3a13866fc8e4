"""Real-time priority: taken where it is granted, missed with one warning, bounded in any case."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess

import pytest

from tests.support.programs import printed

NICE = os.getpriority(os.PRIO_PROCESS, 0)
UNPRIVILEGED = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")


def works(*within: str) -> bool:
    """Whether a program can be run within these here."""
    return all(shutil.which(name) for name in ("setpriv", "prlimit")) and not subprocess.call(
        [*within, "true"], stderr=subprocess.DEVNULL
    )


def with_limits(*limits: str) -> pytest.MarkDecorator:
    command = ("prlimit", *limits, *UNPRIVILEGED)
    return pytest.mark.skipif(not works(*command), reason=f"{' '.join(command)} does not work here")


def told(program: str, *within: str) -> str:
    out, errors = printed(program, *within)
    assert errors == []
    return out


CLAIM = """
import os, resource, threading
from device.stream.callback_thread import AudioPriority

priority = AudioPriority({wanted})
def audio():
    priority.claim()
    priority.claim()
    policy = os.sched_getscheduler(0)
    print("real-time" if policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR else "usual",
          bool(policy & os.SCHED_RESET_ON_FORK), os.sched_getparam(0).sched_priority,
          os.getpriority(os.PRIO_PROCESS, 0), end="; ")
thread = threading.Thread(target=audio)
thread.start()
thread.join()
print(os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0), end="; ")
print(resource.getrlimit(resource.RLIMIT_RTTIME), priority.warning)
"""


def can_be_real_time() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(10))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


needs_real_time = pytest.mark.skipif(
    not can_be_real_time(), reason="this machine grants no real-time priority"
)


@needs_real_time
def test_where_it_is_granted_only_the_thread_that_asks_has_it_and_may_not_spin() -> None:
    assert told(CLAIM.format(wanted=True)) == (
        f"real-time True 10 {NICE}; 0 {NICE}; (200000, 2000000)"
    )


@with_limits("--rtprio=0:5")
def test_the_users_limit_is_used_even_where_it_has_to_be_raised() -> None:
    limited = ("prlimit", "--rtprio=0:5", *UNPRIVILEGED)
    assert told(CLAIM.format(wanted=True), *limited).startswith(
        f"real-time True 5 {NICE}; 0 {NICE};"
    )


@with_limits("--rtprio=0:0", "--nice=0:31")
def test_without_it_a_nice_level_does_and_nobody_is_warned() -> None:
    limited = ("prlimit", "--rtprio=0:0", "--nice=0:31", *UNPRIVILEGED)
    assert told(CLAIM.format(wanted=True), *limited).startswith(f"usual False 0 -11; 0 {NICE};")
    assert told(CLAIM.format(wanted=True), *limited).endswith("(200000, 2000000)")


@with_limits("--rtprio=0:0", "--nice=0:0")
def test_where_nothing_is_granted_one_warning_says_what_to_do() -> None:
    limited = ("prlimit", "--rtprio=0:0", "--nice=0:0", *UNPRIVILEGED)
    text = told(CLAIM.format(wanted=True), *limited)
    assert text.startswith(f"usual False 0 {NICE}; 0 {NICE};")
    warning = text.partition(") ")[2]
    for part in ("/etc/security/limits.d/cushion.conf", "rtprio 20", "realtime = false"):
        assert part in warning


def test_what_is_switched_off_asks_for_nothing() -> None:
    inherited = resource.getrlimit(resource.RLIMIT_RTTIME)
    assert told(CLAIM.format(wanted=False)) == (f"usual False 0 {NICE}; 0 {NICE}; {inherited}")


SPIN = """
import hashlib, os, sys, threading, time
from audioflinger_hook.cli.process import Signals
from audioflinger_hook.daemon.wake import Wake
from device.stream.callback_thread import AudioPriority

spinning, over = threading.Event(), False
def audio():
    priority.claim()
    spinning.set()
    while not over:  # without Python's lock: waiting for that is a break
        hashlib.pbkdf2_hmac("sha256", b"a", b"b", 200_000)
with Wake() as wake, Signals(wake) as signals:
    priority = AudioPriority()
    signals.on_spinning = priority.revoke
    thread = threading.Thread(target=audio)
    thread.start()
    spinning.wait()
    deadline_s = time.monotonic() + 20.0
    while not priority.warning and time.monotonic() < deadline_s:
        time.sleep(0.01)
    print(os.sched_getscheduler(thread.native_id), priority.wanted, priority.warning)
    priority.set_wanted(True)
    print(priority.warning == "")
    over = True
    thread.join()
"""


@needs_real_time
def test_a_thread_that_spins_loses_it_and_the_process_goes_on() -> None:
    lines = told(SPIN).splitlines()
    assert lines[0].startswith("0 False an audio thread ran for 0.2 s without a break")


RESTORE = """
import os, threading
from device.stream.callback_thread import AudioPriority

priority, asked, done = AudioPriority(), threading.Event(), threading.Event()
def audio():
    claimed = -1
    for _ in range(2):
        if claimed != priority.round:
            claimed = priority.round
            priority.claim()
        done.set()
        asked.wait()
        asked.clear()
    done.set()
def seen():
    return os.sched_getscheduler(thread.native_id) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR
def step():
    done.clear()
    asked.set()
    done.wait()
thread = threading.Thread(target=audio)
thread.start()
done.wait()
told = [seen()]
priority.revoke()
told += [seen(), bool(priority.warning)]
priority.restore()
step()
told += [seen(), bool(priority.warning), priority.round]
priority.restore()
told += [priority.round]
priority.set_wanted(False)
priority.revoke()
priority.restore()
print(*told, priority.wanted, priority.round)
asked.set()
"""


@needs_real_time
def test_what_a_vanished_device_cost_all_threads_is_given_back_once_and_only_then() -> None:
    assert told(RESTORE) == "True False True True False 1 1 False 1"

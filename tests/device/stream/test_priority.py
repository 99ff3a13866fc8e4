"""Real-time priority: taken where it is granted, missed with one warning, bounded in any case."""

import os
import re
import resource
import subprocess

import pytest

from tests.support.programs import printed

NICE = os.getpriority(os.PRIO_PROCESS, 0)
UNPRIVILEGED = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
WARNING = ".*rtprio 20.*/etc/security/limits.d/cushion.conf.*realtime = false.*"


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


needs_real_time = pytest.mark.skipif(not can_be_real_time(), reason="no real-time priority here")


@needs_real_time
def test_where_it_is_granted_only_the_thread_that_asks_has_it_and_may_not_spin():
    granted = f"real-time True 10 {NICE}; 0 {NICE}; (200000, 2000000)"
    assert told(CLAIM.format(wanted=True)) == granted


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        (("--rtprio=0:5",), f"real-time True 5 {NICE}; 0 {NICE};.*"),  # it has to be raised
        (("--rtprio=0:0", "--nice=0:31"), rf"usual False 0 -11; 0 {NICE}; \(200000, 2000000\)"),
        (("--rtprio=0:0", "--nice=0:0"), f"usual False 0 {NICE}; 0 {NICE};{WARNING}"),
    ],
    ids=["the user's limit is used", "a nice level does", "nothing is granted"],
)
def test_what_is_granted_is_taken_and_only_where_nothing_is_somebody_is_warned(limits, says):
    within = ("prlimit", *limits, *UNPRIVILEGED)
    # env: what is missing is an exit code, too
    if subprocess.call(["env", *within, "true"], stderr=subprocess.DEVNULL):
        pytest.skip(f"{' '.join(within)} does not work here")
    assert re.fullmatch(says, told(CLAIM.format(wanted=True), *within), re.DOTALL)


def test_what_is_switched_off_asks_for_nothing():
    inherited = resource.getrlimit(resource.RLIMIT_RTTIME)
    assert told(CLAIM.format(wanted=False)) == (f"usual False 0 {NICE}; 0 {NICE}; {inherited}")


SPIN = """
import hashlib, os, sys, threading, time
from audioflinger_hook.cli.process import Signals
from audioflinger_hook.daemon.timing import Wake
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
def test_a_thread_that_spins_loses_it_and_the_process_goes_on():
    lines = told(SPIN).splitlines()
    assert lines[0].startswith("0 False an audio thread ran for 0.2 s without a break")


RESTORE = """
import os, threading
from concurrent.futures import ThreadPoolExecutor
from device.stream.callback_thread import AudioPriority

priority, audio, claimed = AudioPriority(), ThreadPoolExecutor(1), -1
def block():
    global claimed
    if claimed != priority.round:
        claimed = priority.round
        priority.claim()
    return threading.get_native_id()
def seen():
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR
thread = audio.submit(block).result()
told = [seen()]
priority.revoke()
told += [seen(), bool(priority.warning)]
priority.restore()
audio.submit(block).result()
told += [seen(), bool(priority.warning), priority.round]
priority.restore()
told += [priority.round]
priority.set_wanted(False)
priority.revoke()
priority.restore()
print(*told, priority.wanted, priority.round)
"""


@needs_real_time
def test_what_a_vanished_device_cost_all_threads_is_given_back_once_and_only_then():
    assert told(RESTORE) == "True False True True False 1 1 False 1"

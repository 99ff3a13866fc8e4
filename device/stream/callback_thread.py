"""A callback's thread: its real-time priority, Python's state of it, and its CPU time.

Each thread asks for priority itself, since only PortAudio knows its threads. It gets a low
real-time one, which its children do not inherit, else a better nice level, else nothing. The kernel
limits it: after SPIN_S of uninterrupted processor time the process gets SIGXCPU, upon which
`revoke` must be called; after KILL_S it is killed.
"""

from __future__ import annotations

import ctypes
import getpass
import os
import resource
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path

PRIORITY, NICE = 10, -11  # below sound servers (20 and above); their nice level
SPIN_S, KILL_S = 0.2, 2.0  # a callback takes a hundredth of the first

THREADS_MAX = 64  # that asked are remembered; older ones belong to closed streams


class AudioPriority:
    """Grants priority to the threads that call `claim`. One object serves a whole process.

    wanted: whether threads ask for priority. round: counts effective calls of `restore`; threads
    that claimed before claim again. warning: the missing right and how to get it; "" unless a
    thread was refused.
    """

    def __init__(self, wanted: bool = True) -> None:
        self.wanted = self._revoked = False
        self.round = 0
        self.warning = ""
        self._threads: deque[int] = deque(maxlen=THREADS_MAX)
        self.set_wanted(wanted)

    def set_wanted(self, wanted: bool) -> None:
        """Let threads ask from now on, or take priority away from all. For the main thread."""
        if wanted and not self.wanted:
            _set_limits()
        self.wanted, self._revoked = wanted, False
        if not wanted:
            self._drop_priorities()
            self.warning = ""

    def claim(self) -> None:
        """Raise the calling thread's priority as far as allowed, without waiting or exceptions."""
        if not self.wanted:
            return
        self._threads.append(threading.get_native_id())
        if not (_real_time() or _nicer()):
            self.warning = priority_advice()

    def revoke(self) -> None:
        """Take priority away from all threads, as one ran too long. For a signal handler."""
        self._revoked = self._revoked or self.wanted
        self.wanted = False
        self._drop_priorities()
        self.warning = (
            f"an audio thread ran for {SPIN_S:g} s without a break, so all of them lost their "
            "real-time priority; restart, or plug the device in again, to try again"
        )

    def restore(self) -> None:
        """Undo `revoke` once the stream of a card that was pulled out, and spun, is closed."""
        if self._revoked:
            self.round += 1
            self.warning = ""
            self.set_wanted(True)

    def _drop_priorities(self) -> None:
        mine = {int(entry.name) for entry in Path("/proc/self/task").iterdir()}
        for thread in mine.intersection(self._threads):
            with suppress(OSError):  # it has ended
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        self._threads.clear()


def priority_advice() -> str:
    """Return advice for a user whose audio threads have no real-time priority."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without a name
        user = str(os.getuid())
    return (
        "the audio threads have no real-time priority, so vibration may break up on a busy "
        f"machine; put `{user} - rtprio {2 * PRIORITY}` into "
        "/etc/security/limits.d/cushion.conf and log in again, or set realtime = false"
    )


def _real_time() -> bool:
    """Set the calling thread's real-time priority; a privileged process ignores the limit."""
    policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
    allowed = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    for priority in (PRIORITY, min(PRIORITY, allowed)):
        with suppress(OSError, ValueError):
            os.sched_setscheduler(0, policy, os.sched_param(priority))
            return True
    return False


def _nicer() -> bool:
    """Improve the calling thread's nice level, which Linux keeps per thread."""
    limit = resource.getrlimit(resource.RLIMIT_NICE)[0]
    lowest = -20 if limit == resource.RLIM_INFINITY else 20 - limit
    for level in (NICE, max(NICE, lowest)):
        with suppress(OSError):
            if level < 0:
                if os.getpriority(os.PRIO_PROCESS, 0) > level:
                    os.setpriority(os.PRIO_PROCESS, 0, level)
                return True
    return False


def _set_limits() -> None:
    """Raise the soft limits to the hard ones, and limit uninterrupted time; a lower one stays."""
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE):
        hard = resource.getrlimit(limit)[1]
        with suppress(OSError, ValueError):
            resource.setrlimit(limit, (hard, hard))
    _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    kill_us = int(KILL_S * 1e6)
    most_us = kill_us if hard == resource.RLIM_INFINITY else min(hard, kill_us)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_RTTIME, (min(int(SPIN_S * 1e6), most_us), most_us))


RELEASE_LIMIT_S = 0.05  # several callbacks: if none comes in this time, the stream has stopped

_LOCKED = 0  # PyGILState_LOCKED of Python's C API: the caller holds the lock, as in a callback

_ensure = ctypes.pythonapi.PyGILState_Ensure
_release = ctypes.pythonapi.PyGILState_Release
_release.argtypes = [ctypes.c_int]
_release.restype = None


class GilState:
    """Python's state of the thread that calls one stream's callbacks.

    Python creates and frees a state for every call from a thread that it does not know. At some
    hundred callbacks per second that costs as much as the callbacks.

    That thread calls `keep` and `release`, inside a callback. A stream that stops between two
    callbacks leaks the state, about 20 kB; `wait_released` avoids that.
    """

    def __init__(self) -> None:
        self._released = threading.Event()
        self._released.set()

    def keep(self) -> None:
        """Keep the state after this callback returns. Further calls do nothing."""
        if self._released.is_set():
            self._released.clear()
            _ensure()

    def release(self) -> None:
        """Let Python free the state after this callback and every later one."""
        if not self._released.is_set():
            _release(_LOCKED)
            self._released.set()

    def wait_released(self) -> bool:
        """Wait until released, RELEASE_LIMIT_S at most; whether it was. Any other thread."""
        return self._released.wait(RELEASE_LIMIT_S)


def cpu_time_s() -> float:
    """Return the CPU time of the calling thread; only differences have a meaning."""
    return time.thread_time()

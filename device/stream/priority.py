"""Real-time priority for audio threads, where the system grants it.

Each thread asks for itself, since only PortAudio knows its threads. It gets a low real-time
priority, which its children do not inherit, else a better nice level, else nothing. The kernel
limits it: after SPIN_S of uninterrupted processor time the process gets SIGXCPU, upon which
`revoke` must be called; after KILL_S it is killed.
"""

from __future__ import annotations

import getpass
import os
import resource
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path

PRIORITY = 10
"""Below sound servers (20 and above) and the kernel's threads (50)."""

NICE = -11
"""The nice level of sound servers."""

SPIN_S = 0.2
"""Limit of uninterrupted processor time. A callback takes a hundredth of it."""

KILL_S = 2.0

THREADS_MAX = 64
"""The newest threads that asked are remembered; older ones belong to closed streams."""


class AudioPriority:
    """Grants priority to the threads that call `claim`. One object serves a whole process.

    Parameters
    ----------
    wanted : bool
        Whether threads ask for priority at all.

    Attributes
    ----------
    wanted : bool
        As above; set by `set_wanted`, cleared by `revoke`.
    warning : str
        What is missing and how to get it; "" unless a thread was refused.
    """

    def __init__(self, wanted: bool = True) -> None:
        self.wanted = False
        self.warning = ""
        self._threads: deque[int] = deque(maxlen=THREADS_MAX)
        self._advice = (
            "the audio threads have no real-time priority, so vibration may break up on a busy "
            f"machine; put `{_user()} - rtprio {2 * PRIORITY}` into "
            "/etc/security/limits.d/cushion.conf and log in again, or set realtime = false"
        )
        self.set_wanted(wanted)

    def set_wanted(self, wanted: bool) -> None:
        """Let threads ask from now on, or take priority away from all. For the main thread."""
        if wanted and not self.wanted:
            _use_limits()
            _limit_spinning()
        self.wanted = wanted
        if not wanted:
            self._drop_priorities()
            self.warning = ""

    def claim(self) -> None:
        """Raise the calling thread's priority as far as allowed, without waiting or exceptions."""
        if not self.wanted:
            return
        self._threads.append(threading.get_native_id())
        if not (_real_time() or _nicer()):
            self.warning = self._advice

    def revoke(self) -> None:
        """Take priority away from all threads, as one ran too long. For a signal handler."""
        self.wanted = False
        self._drop_priorities()
        self.warning = (
            f"an audio thread ran for {SPIN_S:g} s without a break, so all of them lost their "
            "real-time priority; restart to try again"
        )

    def _drop_priorities(self) -> None:
        mine = {int(entry.name) for entry in Path("/proc/self/task").iterdir()}
        for thread in mine.intersection(self._threads):
            with suppress(OSError):  # it has ended
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        self._threads.clear()


def _real_time() -> bool:
    """Set the calling thread's real-time priority; a privileged process ignores the limit."""
    allowed = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    for priority in (PRIORITY, min(PRIORITY, allowed)):
        with suppress(OSError, ValueError):
            policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(priority))
            return True
    return False


def _nicer() -> bool:
    """Improve the calling thread's nice level, which Linux keeps per thread."""
    limit = resource.getrlimit(resource.RLIMIT_NICE)[0]
    lowest = -20 if limit == resource.RLIM_INFINITY else 20 - limit
    for level in (NICE, max(NICE, lowest)):
        with suppress(OSError):
            if os.getpriority(os.PRIO_PROCESS, 0) <= level < 0:
                return True
            if level < 0:
                os.setpriority(os.PRIO_PROCESS, 0, level)
                return True
    return False


def _use_limits() -> None:
    """Raise the soft limits to the hard ones."""
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE):
        hard = resource.getrlimit(limit)[1]
        with suppress(OSError, ValueError):
            resource.setrlimit(limit, (hard, hard))


def _limit_spinning() -> None:
    """Limit a real-time thread's uninterrupted processor time; a lower limit stays."""
    _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    kill_us = int(KILL_S * 1e6)
    most_us = kill_us if hard == resource.RLIM_INFINITY else min(hard, kill_us)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_RTTIME, (min(int(SPIN_S * 1e6), most_us), most_us))


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user without a name
        return str(os.getuid())

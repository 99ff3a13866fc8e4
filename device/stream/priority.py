"""Real-time priority for the threads that sound depends on, where the system grants it.

A thread asks for itself, since nobody here knows which threads PortAudio has. It gets a low
real-time priority, which nothing that it starts inherits, else a better nice level, else nothing;
asking neither waits nor raises. A real-time thread that never sleeps could freeze the machine, so
the kernel limits what one may take without a break: after SPIN_S the process is sent SIGXCPU, upon
which `give_back` is to be called, after KILL_S it is killed.
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
"""Above all that is not real-time, below sound servers (20 and above) and the kernel's own (50)."""

NICE = -11
"""What sound servers run at."""

SPIN_S = 0.2
"""Of processor time at once. A callback takes a hundredth of it."""

KILL_S = 2.0

THREADS_MAX = 64
"""The newest that asked are remembered; those of streams that were closed are gone."""


class AudioPriority:
    """What the threads that call `claim` get. One for all streams of a process.

    wanted: whether to ask at all. warning: one line on what is missing and how to get it, "" as
    long as nobody was refused. Any thread may read it.
    """

    def __init__(self, wanted: bool = True) -> None:
        self.wanted = False
        self.warning = ""
        self._threads: deque[int] = deque(maxlen=THREADS_MAX)
        self._advice = (
            "the audio threads have no real-time priority, so that vibration may break up on a "
            f"busy machine; put `{_user()} - rtprio {2 * PRIORITY}` into "
            "/etc/security/limits.d/cushion.conf and log in again, or set realtime = false"
        )
        self.set_wanted(wanted)

    def set_wanted(self, wanted: bool) -> None:
        """Let threads from now on ask, or none, and those that have it give it back.

        For the main thread.
        """
        if wanted and not self.wanted:
            _use_limits()
            _limit_spinning()
        self.wanted = wanted
        if not wanted:
            self._return()
            self.warning = ""

    def claim(self) -> None:
        """Give the calling thread what it may have. It may call this again; it raises nothing."""
        if not self.wanted:
            return
        self._threads.append(threading.get_native_id())
        if not (_real_time() or _nicer()):
            self.warning = self._advice

    def revoke(self) -> None:
        """Let no thread have it any more: one has taken too much. A signal handler may call it."""
        self.wanted = False
        self._return()
        self.warning = (
            f"an audio thread has run for {SPIN_S:g} s without a break, so that all of them lost "
            "their real-time priority; start anew to try again"
        )

    def _return(self) -> None:
        mine = {int(entry.name) for entry in Path("/proc/self/task").iterdir()}
        for thread in mine.intersection(self._threads):
            with suppress(OSError):  # it ended meanwhile
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        self._threads.clear()


def _real_time() -> bool:
    """Give the calling thread a real-time priority; with privileges, limits do not count."""
    allowed = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    for priority in (PRIORITY, min(PRIORITY, allowed)):
        with suppress(OSError, ValueError):
            policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(priority))
            return True
    return False


def _nicer() -> bool:
    """Give the calling thread a better nice level (Linux has one for each thread)."""
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
    """Use what the hard limits leave."""
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE):
        hard = resource.getrlimit(limit)[1]
        with suppress(OSError, ValueError):
            resource.setrlimit(limit, (hard, hard))


def _limit_spinning() -> None:
    """Bound what a real-time thread may take at once; a lower limit that is there stays."""
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

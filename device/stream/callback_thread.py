"""The threads that run callbacks: real-time priority, Python thread state and CPU time.

Each thread requests its priority itself, because PortAudio does not tell which threads it created.
The thread gets a low real-time priority, which child processes do not inherit. If this is refused,
the thread tries to lower its nice level. The kernel limits the uninterrupted CPU time of real-time
threads. After SPIN_S the kernel sends SIGXCPU to the process, whose signal handler must call
`AudioPriority.revoke`. After KILL_S the kernel kills the process.
"""

import ctypes
import getpass
import os
import resource
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path

PRIORITY, NICE = 10, -11  # sound servers usually have priority 20 or more, and nice level -11
SPIN_S, KILL_S = 0.2, 2.0  # limits of uninterrupted CPU time


class AudioPriority:
    """Gives real-time priority to the threads that call `claim`. A process needs only one object.

    wanted: whether `claim` has an effect. round: number of times that `restore` undid `revoke`;
    after each increase, every thread must call `claim` again. warning: why threads were refused
    priority or lost it, with the remedy; "" otherwise.
    """

    def __init__(self, wanted: bool = True) -> None:
        self.wanted = self._revoked = False
        self.round = 0
        self.warning = ""
        self._threads: deque[int] = deque(maxlen=64)  # older threads belong to closed streams
        self.set_wanted(wanted)

    def set_wanted(self, wanted: bool) -> None:
        """Allow `claim`, or undo it for all threads. Only the main thread may call this."""
        if wanted and not self.wanted:  # raise the soft limits, and limit uninterrupted CPU time
            for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE):
                hard = resource.getrlimit(limit)[1]
                with suppress(OSError, ValueError):
                    resource.setrlimit(limit, (hard, hard))
            _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
            kill_us = int(KILL_S * 1e6)
            most_us = kill_us if hard == resource.RLIM_INFINITY else min(hard, kill_us)
            least_us = min(int(SPIN_S * 1e6), most_us)
            with suppress(OSError, ValueError):
                resource.setrlimit(resource.RLIMIT_RTTIME, (least_us, most_us))
        self.wanted, self._revoked = wanted, False
        if not wanted:
            self._drop_priorities()
            self.warning = ""

    def claim(self) -> None:
        """Increase the calling thread's priority if permitted. This never waits or raises."""
        if not self.wanted:
            return
        self._threads.append(threading.get_native_id())
        if not (_real_time() or _nicer()):
            self.warning = priority_advice()

    def revoke(self) -> None:
        """Remove all threads' priority because one ran too long. SIGXCPU's handler calls this."""
        self._revoked = self._revoked or self.wanted
        self.wanted = False
        self._drop_priorities()
        self.warning = (
            f"an audio thread ran for {SPIN_S:g} s without a break, so all of them lost their "
            "real-time priority; restart, or plug the device in again, to try again"
        )

    def restore(self) -> None:
        """Undo `revoke`. Call this after closing the stream whose thread ran too long."""
        if self._revoked:
            self.round += 1
            self.warning = ""
            self.set_wanted(True)

    def _drop_priorities(self) -> None:
        mine = {int(entry.name) for entry in Path("/proc/self/task").iterdir()}
        for thread in mine.intersection(self._threads):
            with suppress(OSError):  # the thread has ended
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        self._threads.clear()


def priority_advice() -> str:
    """Return advice for a user whose audio threads cannot get real-time priority."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # in a container the user may have no name
        user = str(os.getuid())
    return (
        "the audio threads have no real-time priority, so vibration may break up on a busy "
        f"machine; put `{user} - rtprio {2 * PRIORITY}` into "
        "/etc/security/limits.d/cushion.conf and log in again, or set realtime = false"
    )


def _real_time() -> bool:
    """Give the calling thread real-time priority; return whether that was permitted."""
    policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
    for priority in (PRIORITY, min(PRIORITY, resource.getrlimit(resource.RLIMIT_RTPRIO)[0])):
        with suppress(OSError, ValueError):
            os.sched_setscheduler(0, policy, os.sched_param(priority))
            return True
    return False


def _nicer() -> bool:
    """Lower the nice level of the calling thread alone; return whether it is now below 0."""
    limit = resource.getrlimit(resource.RLIMIT_NICE)[0]
    lowest = -20 if limit == resource.RLIM_INFINITY else 20 - limit
    for level in (NICE, max(NICE, lowest)):
        with suppress(OSError):
            if level < 0:
                if os.getpriority(os.PRIO_PROCESS, 0) > level:
                    os.setpriority(os.PRIO_PROCESS, 0, level)
                return True
    return False


RELEASE_LIMIT_S = 0.05  # several callback periods; a stream with longer gaps has stopped

_LOCKED = 0  # PyGILState_LOCKED of Python's C API: the caller holds the GIL, as in a callback

_ensure = ctypes.pythonapi.PyGILState_Ensure
_release = ctypes.pythonapi.PyGILState_Release
_release.argtypes = [ctypes.c_int]
_release.restype = None


class GilState:
    """The Python thread state of the thread that calls one stream's callbacks.

    Without `keep`, Python creates and frees a thread state at every callback, which takes CPU time.
    Only a callback may call `keep` and `release`. If the stream stops before `release`, the state
    is never freed. Before closing the stream, another thread therefore calls `wait_released`.
    """

    def __init__(self) -> None:
        self._released = threading.Event()
        self._released.set()

    def keep(self) -> None:
        """Keep the state from callback to callback, until `release`. May be repeated."""
        if self._released.is_set():
            self._released.clear()
            _ensure()

    def release(self) -> None:
        """Undo `keep`: Python frees the state when this callback returns. May be repeated."""
        if not self._released.is_set():
            _release(_LOCKED)
            self._released.set()

    def wait_released(self) -> bool:
        """Wait up to RELEASE_LIMIT_S for `release`; return whether the state is released."""
        return self._released.wait(RELEASE_LIMIT_S)


cpu_time_s = (
    time.thread_time
)  # CPU time of the calling thread in s; only differences are meaningful

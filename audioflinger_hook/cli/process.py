"""Process-wide settings of long-running commands: signals, open files and garbage collection."""

import gc
import os
import resource
import signal
from collections.abc import Callable
from contextlib import AbstractContextManager

from audioflinger_hook.daemon.timing import Wake
from device.errors import UsageError

NEEDED, WANTED = 64, 512  # lowest accepted limit of open files, and the limit to set


class Signals(AbstractContextManager["Signals"]):
    """Stores received signals as attributes for the main thread, and wakes it through `wake`.

    These signals raise no exception. The context manager restores the previous handlers at exit.

    end: set by SIGINT and SIGTERM, and, except with `nohup`, by SIGHUP if the terminal was closed.
    reload: set by any other SIGHUP. on_spinning: called on SIGXCPU, which the system sends when a
    real-time thread runs for too long.
    """

    def __init__(self, wake: Wake) -> None:
        self.end = self.reload = False
        self.on_spinning: Callable[[], None] = lambda: None
        self._wake = wake
        self._terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]
        # `nohup` makes a program continue without its terminal.
        self._goes_on = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU)
        self._before = {number: signal.signal(number, self._take) for number in numbers}

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, _frame: object) -> None:
        if number == signal.SIGXCPU:
            self.on_spinning()
        elif number == signal.SIGHUP and (self._goes_on or all(map(os.isatty, self._terminals))):
            self.reload = True
        else:
            self.end = True
        self._wake.ring()


def freeze_loaded_objects() -> None:
    """Exempt all present objects from garbage collection, which then takes less time.

    Call it before sound plays, because it stops all threads for a full collection.
    """
    gc.collect()
    gc.freeze()


def allow_open_files() -> None:
    """Raise the limit of open files up to WANTED. UsageError: the hard limit is below NEEDED."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= WANTED:
        return
    allowed = WANTED if hard == resource.RLIM_INFINITY else min(WANTED, hard)
    if allowed < NEEDED:
        few = f"only {allowed} files may be open at once (ulimit -n)"
        raise UsageError(f"{few}; cushion run needs {NEEDED}: raise the limit and start it again")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))

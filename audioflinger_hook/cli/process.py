"""What a long command asks of its process: signals, open files and collections."""

from __future__ import annotations

import gc
import os
import resource
import signal
from collections.abc import Callable

from audioflinger_hook.daemon.wake import Wake
from device.errors import UsageError

NEEDED, WANTED = 64, 512
"""A daemon with a sound server, eight pages and a recording has about fifty files open."""


class Signals:
    """What signals have requested, for the main thread; each signal wakes it by `wake`.

    None interrupts the opening or closing of streams. As a context manager it restores the former
    handlers in the end. end: after SIGINT, SIGTERM, or if the terminal was closed. reload: after
    SIGHUP. on_spinning: called at once after SIGXCPU: a real-time thread has run for too long.
    """

    def __init__(self, wake: Wake) -> None:
        self.end = False
        self.reload = False
        self.on_spinning: Callable[[], None] = lambda: None
        self._wake = wake
        self._terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]
        # With `nohup` a program goes on without its terminal.
        self._goes_on = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        handlers = {
            signal.SIGINT: self._end,
            signal.SIGTERM: self._end,
            signal.SIGHUP: self._hang_up,
            signal.SIGXCPU: self._spinning,
        }
        self._before = {number: signal.signal(number, take) for number, take in handlers.items()}

    def __enter__(self) -> Signals:
        return self

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _end(self, _number: int, _frame: object) -> None:
        self.end = True
        self._wake.ring()

    def _hang_up(self, _number: int, _frame: object) -> None:
        closed = [terminal for terminal in self._terminals if not os.isatty(terminal)]
        if closed and not self._goes_on:
            self.end = True
        else:
            self.reload = True
        self._wake.ring()

    def _spinning(self, _number: int, _frame: object) -> None:
        self.on_spinning()
        self._wake.ring()


def freeze_loaded_objects() -> None:
    """Exempt all present objects from later collections. Any thread, before sound plays.

    A full collection, which this call makes, stops all threads for about 50 ms; one of only new
    objects takes 0.1 ms.
    """
    gc.collect()
    gc.freeze()


def allow_open_files() -> None:
    """Raise the limit of open files. Main thread only. UsageError: too few are allowed."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= WANTED:
        return
    allowed = WANTED if hard == resource.RLIM_INFINITY else min(WANTED, hard)
    if allowed < NEEDED:
        few = f"only {allowed} files may be open at once (ulimit -n)"
        raise UsageError(f"{few}; cushion run needs {NEEDED}: raise the limit and start it again")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))

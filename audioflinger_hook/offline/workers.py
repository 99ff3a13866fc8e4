"""Work spread over processes: results in order; if a process dies, only its item is lost.

The pool of `concurrent.futures`, in contrast, breaks as a whole when one process dies.
"""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from types import FrameType
from typing import Generic, TypeVar

Result = TypeVar("Result")

ReportShare = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1, at any time."""

SHARE_STEP = 0.02
"""Smaller steps of the share are not reported."""

END_S = 5.0
"""Time that a process may take to clean up when it is ended."""

WORKERS_MAX = 256

AHEAD = 2
"""Items per process that may be started before the result of the first has been taken."""

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class WorkerLost(Exception):
    """A process ended before its work was done; the text says why."""


def usable_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class _Worker:
    process: ForkProcess
    messages: Connection
    item: int
    share: float = 0.0


class Workers(Generic[Result]):
    """Calls `work(item, report_share)` for every item, each in a separate process.

    Use it as a context manager, from one thread. Leaving it ends unfinished work by
    KeyboardInterrupt in the process, and waits for the process. The processes ignore SIGINT.

    work: any function whose result can be pickled. It runs in a fork of this process. An error that
        it raises counts as `WorkerLost`.
    items: items are numbered from 0.
    count: largest number of processes at once.
    """

    def __init__(self, work: Callable[[int, ReportShare], Result], items: int, count: int) -> None:
        # A fork starts at once; the other methods would import everything again.
        self._context = multiprocessing.get_context("fork")
        self._work = work
        self._items = items
        self._next = 0
        self._most_ahead = AHEAD * count
        self._yielded = 0
        self._running: list[_Worker] = []
        self._done: dict[int, Result | WorkerLost] = {}
        self._count = count
        self._start_more()

    def results(self, report_share: ReportShare | None = None) -> Iterator[Result | WorkerLost]:
        """Yield the results in the order of items. report_share: takes the share of all items."""
        for item in range(self._items):
            while item not in self._done:
                self._listen()
                if report_share:
                    under_way = sum(worker.share for worker in self._running)
                    finished = self._next - len(self._running)
                    report_share((finished + under_way) / self._items)
            result = self._done.pop(item)
            self._yielded = item + 1
            self._start_more()
            yield result

    def __enter__(self) -> Workers[Result]:
        return self

    def __exit__(self, *_error: object) -> None:
        for worker in self._running:
            worker.process.terminate()
        for worker in self._running:
            worker.process.join(END_S)
            if worker.process.exitcode is None:
                worker.process.kill()
                worker.process.join()
            worker.messages.close()
        self._running.clear()

    def _start_more(self) -> None:
        """Start items until all processes are busy or too many results wait to be taken."""
        most = min(self._items, self._yielded + self._most_ahead)
        while len(self._running) < self._count and self._next < most:
            self._start()

    def _start(self) -> None:
        """Start the next item."""
        item, self._next = self._next, self._next + 1
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._context.Process(target=self._run, args=(item, ours, theirs), daemon=True)
        # Signals wait until the new process has its own handlers.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            with warnings.catch_warnings():
                # Python warns of forks in a process with threads. The only threads are those of
                # BLAS, which handles forks, and of a progress bar, which the work does not use.
                warnings.simplefilter("ignore", DeprecationWarning)
                process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self._running.append(_Worker(process, ours, item))

    def _run(self, item: int, ours: Connection, theirs: Connection) -> None:
        """Do one item, in its process."""
        # With these closed, `theirs` breaks as soon as the parent process is gone.
        for connection in (ours, *(worker.messages for worker in self._running)):
            connection.close()
        # Another thread may have held the locks of these streams when the process was forked.
        sys.stdout = sys.stderr = io.StringIO()
        sent = 0.0

        def report_share(share: float) -> None:
            nonlocal sent
            if share >= sent + SHARE_STEP:
                sent = share
                theirs.send((False, share))

        # BrokenPipeError: the parent process is gone, and nobody wants the result.
        with suppress(KeyboardInterrupt, BrokenPipeError):
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGHUP, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, _interrupt_once)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            theirs.send((True, self._work(item, report_share)))

    def _listen(self) -> None:
        """Wait for messages, and start the next item whenever an item is done."""
        ready = wait([worker.messages for worker in self._running])
        for worker in [worker for worker in self._running if worker.messages in ready]:
            try:
                done, message = worker.messages.recv()
            except EOFError:
                worker.process.join()
                done, message = True, WorkerLost(_how_it_ended(worker.process.exitcode))
            if not done:
                worker.share = message
                continue
            self._running.remove(worker)
            worker.process.join()
            worker.messages.close()
            self._done[worker.item] = message
        self._start_more()


def _interrupt_once(_signal: int, _frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, and ignore further signals during the clean-up."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _how_it_ended(exitcode: int | None) -> str:
    if exitcode is not None and exitcode < 0:
        return f"ended by {signal.Signals(-exitcode).name}"
    return f"ended with exit code {exitcode}"

"""Work spread over processes of its own: results in order, whatever ends a worker."""

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
from types import FrameType, TracebackType
from typing import Generic, TypeVar

Result = TypeVar("Result")

Tell = Callable[[float], None]
"""Told by the work, as often as it likes, which share of itself is done, 0 to 1."""

TOLD_FROM = 0.02
"""Smaller steps are not passed on."""

END_S = 5.0
"""How long a worker may take to put away what it has begun."""

WORKERS_MAX = 256

LEAD = 2
"""Items for each process that may be begun before the first of them has been taken."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class WorkerLost(Exception):
    """A worker ended before its work did; the text says by what."""


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
    """Does `work(item, tell)` for every item from 0 to `items`, each in a process of its own.

    count: how many processes at once, at most. work: runs in a copy of this process as it is when
    its worker begins, so that it costs nothing to begin and may be any function; what it returns
    must be picklable, and it may raise nothing but what is told as `WorkerLost`.

    As a context manager: on leaving, work that is under way is ended as by a signal to terminate
    (KeyboardInterrupt in it), and waited for. To be used from one thread. A worker ignores
    SIGINT: whoever holds this decides.
    """

    def __init__(self, work: Callable[[int, Tell], Result], items: int, count: int) -> None:
        # Copies of this process: another way to begin one would import everything again.
        self._context = multiprocessing.get_context("fork")
        self._work = work
        self._items = items
        self._next = 0
        self._most_ahead = LEAD * count
        self._yielded = 0
        self._running: list[_Worker] = []
        self._done: dict[int, Result | WorkerLost] = {}
        self._count = count
        self._begin_more()

    def results(self, tell: Tell | None = None) -> Iterator[Result | WorkerLost]:
        """Yield what came of each item, in their order. tell: told the share of all items."""
        for item in range(self._items):
            while item not in self._done:
                self._listen()
                if tell:
                    under_way = sum(worker.share for worker in self._running)
                    finished = self._next - len(self._running)
                    tell((finished + under_way) / self._items)
            result = self._done.pop(item)
            self._yielded = item + 1
            self._begin_more()
            yield result

    def __enter__(self) -> Workers[Result]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for worker in self._running:
            worker.process.terminate()
        for worker in self._running:
            worker.process.join(END_S)
            if worker.process.exitcode is None:
                worker.process.kill()
                worker.process.join()
            worker.messages.close()
        self._running.clear()

    def _begin_more(self) -> None:
        """Begin items until all processes are busy or too many results wait to be taken."""
        most = min(self._items, self._yielded + self._most_ahead)
        while len(self._running) < self._count and self._next < most:
            self._begin()

    def _begin(self) -> None:
        """Begin the next item."""
        item, self._next = self._next, self._next + 1
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._context.Process(target=self._do, args=(item, ours, theirs), daemon=True)
        # A signal that comes while there are two of us waits until each knows what to do with it.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            with warnings.catch_warnings():
                # Of other threads there are those of the library for linear algebra, which knows
                # of forks, and that of a progress bar, which no worker touches.
                warnings.simplefilter("ignore", DeprecationWarning)
                process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self._running.append(_Worker(process, ours, item))

    def _do(self, item: int, ours: Connection, theirs: Connection) -> None:
        """Do one item; runs in the worker."""
        # So that `theirs` breaks when the process that listens is gone, and that of others, too.
        for connection in (ours, *(worker.messages for worker in self._running)):
            connection.close()
        # A worker says nothing, and another thread may have held these when it was copied.
        sys.stdout = sys.stderr = io.StringIO()
        told = 0.0

        def tell(share: float) -> None:
            nonlocal told
            if share >= told + TOLD_FROM:
                told = share
                theirs.send((False, share))

        # Broken: who began this is gone, and wants nothing any more.
        with suppress(KeyboardInterrupt, BrokenPipeError):
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, _interrupt_once)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            theirs.send((True, self._work(item, tell)))

    def _listen(self) -> None:
        """Wait for word of any worker, and begin the next item where one is done."""
        ready = wait([worker.messages for worker in self._running])
        for worker in [worker for worker in self._running if worker.messages in ready]:
            try:
                done, told = worker.messages.recv()
            except EOFError:
                worker.process.join()
                done, told = True, WorkerLost(_how_it_ended(worker.process.exitcode))
            if not done:
                worker.share = told
                continue
            self._running.remove(worker)
            worker.process.join()
            worker.messages.close()
            self._done[worker.item] = told
        self._begin_more()


def _interrupt_once(_signal: int, _frame: FrameType | None) -> None:
    """End the work, and leave what it puts away in peace."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _how_it_ended(exitcode: int | None) -> str:
    """Return how a process ended, in words."""
    if exitcode is not None and exitcode < 0:
        return f"ended by {signal.Signals(-exitcode).name}"
    return f"ended with exit code {exitcode}"

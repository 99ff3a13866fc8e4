"""Where batches of work run: this process, or a pool of processes.

`catalogue/cluster.py` adds a cluster.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, MutableSequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from multiprocessing import forkserver
from multiprocessing.connection import wait
from types import FrameType
from typing import Any, Self, TypeVar

T = TypeVar("T")

WORKERS_MAX = 256
DIED = "for lack of memory or by a fault of a decoder; look at the file and the machine's log"

_shares: MutableSequence[float] = []  # in a worker: the pool's


def usable_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


class Place:
    """A place where batches run, itself this process; a context manager. Use from one thread."""

    def slots(self) -> int:
        """Return how many batches run at once now."""
        return 1

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Start a batch, or let it wait for a slot; this process does it at once."""
        future: Future[T] = Future()
        future.set_result(work(*arguments))
        return future

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether a batch failed because its worker died. The place then works again."""
        return False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        pass


class LocalWorkers(Place):
    """Processes of this machine; when one dies, the next `submit` starts all again.

    count: processes at once. preload: the module of the work, imported once for all processes.
    items: number of items that may `report_share`. shares: share of each item that is done, 0 to 1.
    """

    def __init__(self, count: int, preload: str, items: int = 0) -> None:
        self._count = count
        # Workers use all cores already: threads of BLAS would only wait for one another.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        # A server process imports everything once and forks workers, which then start at once.
        # Forks of this process would inherit the state of its threads.
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([preload])
        # A closed terminal ends this process alone, which then ends the server and its workers.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGHUP,))
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.shares: MutableSequence[float] = self._context.RawArray("d", items)
        self._pool = self._new_pool()

    def slots(self) -> int:
        """Return the number of processes."""
        return self._count

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Start a batch in a process."""
        try:
            return self._pool.submit(_unless_ended, work, *arguments)
        except BrokenExecutor:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = self._new_pool()
            return self._pool.submit(_unless_ended, work, *arguments)

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether the pool broke."""
        return isinstance(error, BrokenExecutor)

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is not None:
            # Items under way are dropped. Results appear whole, so nothing half is left.
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, self._context, _begin_worker, (self.shares,))


def report_share(item: int, share: float) -> None:
    """Report the share of an item that is done to the pool; called by the work in a worker."""
    _shares[item] = share


def _begin_worker(shares: MutableSequence[float]) -> None:
    """Prepare a worker: the main process handles Ctrl-C and SIGHUP, and no worker outlives it."""
    global _shares
    _shares = shares
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def end_with_parent() -> None:
        if parent := multiprocessing.parent_process():
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _interrupt_once(_signal: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _unless_ended(work: Callable[..., T], *arguments: Any) -> T:
    """Return the work's result; after SIGTERM the process ends, when files are cleaned up.

    Between batches SIGTERM ends a process at once, without a traceback.
    """
    try:
        signal.signal(signal.SIGTERM, _interrupt_once)
        try:
            return work(*arguments)
        finally:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
    except KeyboardInterrupt:
        os._exit(1)

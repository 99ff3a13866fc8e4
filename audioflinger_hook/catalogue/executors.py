"""Where batches run: in this process, in processes of this machine, or on a Dask cluster.

Each is a `concurrent.futures.Executor`; Dask offers one, too.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import suppress
from multiprocessing.connection import wait
from types import FrameType, TracebackType
from typing import Any, Protocol, TypeVar

from audioflinger_hook.catalogue.addresses import NO_CREDENTIALS, credentials_in, scrubbed
from device.errors import LostError, UsageError

T = TypeVar("T")

CLUSTER_EXTRA = "--dask needs dask.distributed; pip install 'haptic-cushion[cluster]'"
LOCAL_CLUSTER = "local"
CONNECT_S = "10s"
CLOSE_S = 5.0


class Place(Protocol):
    """A place where batches run; a context manager. Use it from one thread."""

    def slots(self) -> int:
        """Return how many batches run at once now."""
        ...

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Start a batch, or let it wait for a slot."""
        ...

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether a batch failed because its worker died. The place then works again."""
        ...

    def __enter__(self) -> Place: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class ThisProcess:
    """Runs each batch at once, in this process."""

    def slots(self) -> int:
        """Return 1."""
        return 1

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Return a future that is done."""
        future: Future[T] = Future()
        future.set_result(work(*arguments))
        return future

    def lost_worker(self, error: BaseException) -> bool:
        """Return False: only this process hands out work."""
        return False

    def __enter__(self) -> ThisProcess:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        pass


class LocalWorkers:
    """Processes of this machine; when one dies, all are started again.

    Parameters
    ----------
    count : int
        Processes at once.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        # Workers use all cores already: threads of BLAS would only wait for one another.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        # A server process imports everything once and forks workers, which then start at once.
        # Forks of this process would inherit the state of its threads.
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["audioflinger_hook.catalogue.work"])
        self._pool = self._new_pool()

    def slots(self) -> int:
        """Return the number of processes."""
        return self._count

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Start a batch in a process."""
        try:
            return self._pool.submit(_unless_ended, work, *arguments)
        except BrokenExecutor:
            self._renew()
            return self._pool.submit(_unless_ended, work, *arguments)

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether the pool broke; it is replaced by the next `submit`."""
        return isinstance(error, BrokenExecutor)

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is not None:
            # Items under way are dropped. Results appear whole, so nothing half is left.
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, self._context, _begin_worker)

    def _renew(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = self._new_pool()


def _begin_worker() -> None:
    """Prepare a worker: the main process handles Ctrl-C and SIGHUP, and no worker outlives it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def end_with_parent() -> None:
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


class DaskCluster:
    """Workers of a Dask cluster, which may come and go.

    Parameters
    ----------
    address : str
        A scheduler's address, such as tcp://HOST:8786; "local" starts a cluster on this machine.
    count : int
        Workers of a local cluster.

    Raises
    ------
    UsageError
        dask.distributed is not installed.
    LostError
        The scheduler does not answer.
    """

    def __init__(self, address: str, count: int) -> None:
        try:
            import dask
            import distributed
        except ImportError:
            raise UsageError(CLUSTER_EXTRA) from None
        if credentials_in(address):
            raise UsageError(f"--dask={scrubbed(address)} {NO_CREDENTIALS}")
        self._lost = distributed.KilledWorker
        self.address = address
        self._cluster: Any = None
        for name in list(logging.root.manager.loggerDict):
            if name.startswith(("distributed", "tornado")):
                # What they tell reaches the user as errors of ours, without tracebacks.
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        dask.config.set({"distributed.comm.timeouts.connect": CONNECT_S})
        new_client: Any = distributed.Client
        try:
            if address == LOCAL_CLUSTER:
                self._cluster = distributed.LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,
                )
            self._client = new_client(
                self._cluster or address, timeout=CONNECT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError, ImportError) as error:
            said = scrubbed(f"{type(error).__name__}: {error}")
            raise LostError(
                f"no Dask scheduler answers at {scrubbed(address)} ({said}); start one with "
                "`dask scheduler`, or use --dask local"
            ) from None
        self._pool = self._client.get_executor(pure=False)

    def slots(self) -> int:
        """Return how many threads the workers have now, 1 while there are none."""
        if self._client.status != "running":
            raise self._gone()
        return max(1, int(self._client.scheduler_info(n_workers=0)["total_threads"]))

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Send a batch to the scheduler."""
        try:
            future: Future[T] = self._pool.submit(work, *arguments)
        except Exception as error:
            raise self._gone() from error
        return future

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether several workers died with a batch. LostError: the scheduler is gone."""
        if isinstance(error, self._lost):
            return True
        if self._client.status != "running":
            raise self._gone() from None
        return False

    def __enter__(self) -> DaskCluster:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        with suppress(Exception):
            self._pool.shutdown(wait=False)
        with suppress(Exception):
            self._client.close(timeout=CLOSE_S)
        if self._cluster is not None:
            with suppress(Exception):
                self._cluster.close(timeout=CLOSE_S)

    def _gone(self) -> LostError:
        return LostError(
            f"the Dask scheduler at {scrubbed(self.address)} is gone; finished results are kept: "
            "start it and run the same command again"
        )

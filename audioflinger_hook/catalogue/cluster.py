"""Runs batches of items on a Dask cluster. Its workers may join and leave during a run."""

import logging
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, TypeVar

from audioflinger_hook.catalogue.addresses import NO_CREDENTIALS, credentials_in, scrubbed
from audioflinger_hook.offline.batch import Place
from device.errors import LostError, UsageError

T = TypeVar("T")

CLUSTER_EXTRA = "--dask needs dask.distributed; pip install 'haptic-cushion[cluster]'"
LOCAL_CLUSTER = "local"
CONNECT_S = "10s"


class DaskCluster(Place):
    """Workers of a Dask cluster.

    address: address of a scheduler, such as tcp://HOST:8786; "local" starts a cluster on this
    machine. count: number of workers of that cluster. UsageError: dask.distributed is not
    installed, or the address contains credentials. LostError: no scheduler answers.
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
                # This program itself reports errors of the cluster, without tracebacks.
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
            where = self._cluster or address
            self._client = new_client(where, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError, ImportError) as error:
            said = scrubbed(f"{type(error).__name__}: {error}")
            raise LostError(
                f"no Dask scheduler answers at {scrubbed(address)} ({said}); start one with "
                "`dask scheduler`, or use --dask local"
            ) from None
        self._pool = self._client.get_executor(pure=False)

    def slots(self) -> int:
        """Return the number of threads of all workers, or 1 while there is no worker."""
        if self._client.status != "running":
            raise self._gone()
        return max(1, int(self._client.scheduler_info(n_workers=0)["total_threads"]))

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Send work to the scheduler. LostError: the scheduler refuses the work."""
        try:
            return self._pool.submit(work, *arguments)  # type: ignore[no-any-return]
        except Exception as error:
            raise self._gone() from error

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether the error means that workers died. LostError: the scheduler is gone."""
        if isinstance(error, self._lost):
            return True
        if self._client.status != "running":
            raise self._gone() from None
        return False

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        with suppress(Exception):
            self._pool.shutdown(wait=False)
        for one in (self._client, self._cluster):
            with suppress(Exception):
                one.close(timeout=5.0)

    def _gone(self) -> LostError:
        return LostError(
            f"the Dask scheduler at {scrubbed(self.address)} is gone; finished results are kept: "
            "start it and run the same command again"
        )

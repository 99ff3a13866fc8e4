"""Worker processes that execute batches of work, and a function that renders files with them."""

import multiprocessing
import multiprocessing.util
import os
import signal
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from multiprocessing import connection, forkserver, resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any, Self, TypeVar

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import RenderReport, render_file
from audioflinger_hook.sources.tap import named
from device.atomic_file import delete_abandoned_folders, temporary_folder
from device.errors import CushionError, InternalError, UsageError, unexpected
from device.whole_process import repeat_lost_interruptions, respect_memory_limit

T = TypeVar("T")

WORKERS_MAX = 256
STARTS_MAX, START_S = 20, 0.02  # attempts to start workers, and the time between two attempts
SOCKET_FOLDER_BYTES = 44  # the path of a socket in it is 63 bytes longer, and at most 107 bytes
DIED = "for lack of memory or by a fault of a decoder; look at the file and the machine's log"
NO_SERVER = "because the process that starts workers was killed from outside; run it again"
ENDED = "by SIGTERM from outside; run it again"

# Exit codes of workers, the most telling one first, and why such a worker died. 255: unknown to
# `multiprocessing`. 1: SIGTERM, which the executor also sends to all workers after a death.
_DEATHS = {
    -signal.SIGKILL: "by SIGKILL, from outside or for lack of memory; look at the machine's log",
    255: NO_SERVER,
    1: ENDED,
}

_shares: MutableSequence[float] = []  # in a worker process: `LocalWorkers.shares`
_is_ended = False  # in a worker process: SIGTERM came


def usable_cores() -> int:
    """Return the number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0))


class Place:
    """Runs batches of work in this process. Base class of workers. Only one thread may use it."""

    def slots(self) -> int:
        """Return how many batches can run at the same time."""
        return 1

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Start or queue a batch; in this class, run it before returning."""
        future: Future[T] = Future()
        future.set_result(work(*arguments))
        return future

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether `error` means that a worker died; `submit` still works after that."""
        return False

    def death(self) -> str:
        """Return why a worker has just died."""
        return DIED

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        pass


class LocalWorkers(Place):
    """Processes on this computer. If one dies, all end, and the next `submit` starts new processes.

    count: number of processes. preload: module of the work, imported once for all processes.
    items: number of items whose progress is reported. shares: finished part of each item, 0 to 1.
    """

    def __init__(self, count: int, preload: str, items: int = 0) -> None:
        self._count = count
        # Workers already use all cores, so BLAS threads would compete for them.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        self._preload = preload
        delete_abandoned_folders()
        self.shares: MutableSequence[float] = multiprocessing.RawArray("d", items)
        self._pool = self._new_pool()

    def slots(self) -> int:
        """Return the number of processes."""
        return self._count

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T]:
        """Start or queue a batch in one of the processes."""
        for _ in range(STARTS_MAX):
            try:
                return self._pool.submit(_unless_ended, work, *arguments)
            except (BrokenExecutor, OSError, EOFError) as error:  # a process or the forkserver died
                found = error
                self._pool.shutdown(wait=True, cancel_futures=True)
                threading.Event().wait(START_S)  # the forkserver may still be dying
                self._pool = self._new_pool()
        raise InternalError(
            f"workers cannot be started ({found!r}); run the command again"
        ) from found

    def lost_worker(self, error: BaseException | None) -> bool:
        """Return whether `error` means that a process died."""
        return isinstance(error, (BrokenExecutor, CancelledError))

    def death(self) -> str:
        """Wait for the end of all processes, and return why one has died."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        codes = {process.exitcode for process in self._processes.values()}
        by_itself = codes - {None, 0, -signal.SIGTERM, *_DEATHS}
        known = [reason for code, reason in _DEATHS.items() if code in codes]
        return DIED if by_itself or not known else known[0]

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is not None:
            # End the running items. Results appear only when complete, so no partial one remains.
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        # The forkserver imports everything once and forks workers, which start quickly. A fork of
        # this process would inherit the locks of its threads, but costs less for one worker.
        is_fork = self._count == 1 and threading.active_count() == 1
        if not is_fork:
            multiprocessing.get_context("forkserver").set_forkserver_preload([self._preload])
            _prepare_sockets()
            # A signal must end only this process, which then ends the workers and the forkserver.
            ends = signal.SIGHUP, signal.SIGTERM
            before = signal.pthread_sigmask(signal.SIG_BLOCK, ends)
            try:
                resource_tracker.ensure_running()  # this unblocks SIGTERM
                signal.pthread_sigmask(signal.SIG_BLOCK, ends)
                forkserver.ensure_running()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        context = multiprocessing.get_context("fork" if is_fork else "forkserver")
        pool = ProcessPoolExecutor(self._count, context, _begin_worker, (self.shares,))
        if is_fork:
            with warnings.catch_warnings():  # the threads of OpenBLAS allow a fork
                warnings.simplefilter("ignore", DeprecationWarning)
                pool.submit(usable_cores).result()
        assert pool._processes is not None
        self._processes = pool._processes  # filled later, in the case of a forkserver
        return pool


@cache
def _prepare_sockets() -> None:
    """Let `multiprocessing` put its sockets into a folder that a later run would delete."""
    is_long = len(os.fsencode(tempfile.gettempdir())) > SOCKET_FOLDER_BYTES
    opened = ExitStack()
    # Priority -100 is that of `multiprocessing`, which deletes its folder within this one.
    multiprocessing.util.Finalize(None, opened.close, exitpriority=-101)
    folder = opened.enter_context(temporary_folder("/tmp" if is_long else None))
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        multiprocessing.util.get_temp_dir()
    finally:
        tempfile.tempdir = before


def report_share_to_pool(item: int, share: float) -> None:
    """Report the finished part of an item, 0 to 1, from a worker to its `LocalWorkers`."""
    _shares[item] = share


def _begin_worker(shares: MutableSequence[float]) -> None:
    """Prepare a worker: ignore Ctrl-C and SIGHUP, and exit when the main process ends."""
    global _shares
    _shares = shares
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a fork has the handler of its parent
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGTERM,))  # the forkserver blocks it
    repeat_lost_interruptions()
    respect_memory_limit()

    def end_with_parent() -> None:
        if parent := multiprocessing.parent_process():
            connection.wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _interrupt_once(_signal: int, _frame: FrameType | None) -> None:
    global _is_ended
    _is_ended = True
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _unless_ended(work: Callable[..., T], *arguments: Any) -> T:
    """Return the work's result. After SIGTERM, interrupt the work and exit the process."""
    try:
        signal.signal(signal.SIGTERM, _interrupt_once)
        try:
            result = work(*arguments)
        finally:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if not _is_ended:  # a destructor may have lost the interruption
            return result
    except KeyboardInterrupt:
        pass
    os._exit(1)


ReportShare = Callable[[float], None]  # argument: the finished part of the work, 0 to 1
SHARE_S = 0.1  # time between two reports of progress
AHEAD = 4  # files submitted for each process, running or waiting


@dataclass(frozen=True)
class Rendered:
    """The outcome for one file: its report, or a one-line error and its exit code."""

    source: Path
    target: Path
    report: RenderReport | None = None
    error: str = ""
    exit_code: int = 0


def targets_in(folder: Path, sources: Sequence[Path]) -> list[Path]:
    """Return the target of each file: a .wav file of the same name in the folder.

    UsageError: no such folder, two equal targets, or a target that would replace a source.
    """
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "does not exist"
        raise UsageError(f"the output folder {folder} {what}; create it or name another")
    targets = [folder / f"{source.stem}.wav" for source in sources]
    heard = {os.path.realpath(source): source for source in sources}
    taken: dict[str, Path] = {}
    for source, target in zip(sources, targets, strict=True):
        resolved = os.path.realpath(target)
        if resolved in heard:
            raise UsageError(
                f"the vibration of {source} would replace the input {heard[resolved]}; "
                "name another folder"
            )
        if resolved in taken:
            raise UsageError(
                f"{taken[resolved]} and {source} would both become {target}; "
                "rename one, or render them into two folders"
            )
        taken[resolved] = source
    return targets


def render_files(
    sources: Sequence[Path],
    targets: Sequence[Path],
    settings: Settings,
    workers: int,
    report_share: ReportShare | None = None,
) -> Iterator[Rendered]:
    """Render files as `render_file` does, and yield the outcomes in the order of `sources`.

    An error in one file does not affect the others. Ending the iteration discards unfinished files.
    workers: number of processes; 1 uses this process alone.
    report_share: function that is called with the finished part of all files, 0 to 1.
    """
    count = len(sources)
    if min(workers, count) <= 1:
        for item in range(count):
            share = partial(_report_one, report_share, item, count) if report_share else None
            yield _try_file(sources[item], targets[item], settings, share)
        return
    with LocalWorkers(min(workers, count), __name__, count) as pool:

        def submit(item: int) -> Future[Rendered]:
            share = partial(report_share_to_pool, item)
            return pool.submit(_try_file, sources[item], targets[item], settings, share)

        futures: dict[int, Future[Rendered]] = {}
        left = iter(range(count))

        def submit_more() -> None:
            """Submit files until AHEAD per process run or wait; submit none after a worker died."""
            done = [each for each in futures.values() if each.done()]
            if not any(each.cancelled() or pool.lost_worker(each.exception()) for each in done):
                under_way = len(futures) - len(done)
                for item in islice(left, AHEAD * workers - under_way):
                    futures[item] = submit(item)

        def result(future: Future[Rendered], *, alone: bool) -> Rendered:
            while not wait([future], SHARE_S).done:
                if not alone:
                    submit_more()
                if report_share:
                    report_share(sum(pool.shares) / count)
            return future.result()

        for item in range(count):
            submit_more()
            try:
                try:
                    came = result(futures.pop(item), alone=False)
                except (BrokenExecutor, CancelledError):
                    # It is unknown which file killed the process: retry each running file alone.
                    came = result(submit(item), alone=True)
            except (BrokenExecutor, CancelledError):
                died = InternalError(f"{sources[item]}: its process died twice, {pool.death()}")
                came = _failed(sources[item], targets[item], died)
            yield came


def _try_file(
    source: Path, target: Path, settings: Settings, report_share: ReportShare | None
) -> Rendered:
    def progress(frames: int, expected: int | None) -> None:
        if expected and report_share:
            report_share(min(1.0, frames / expected))

    try:
        return Rendered(source, target, render_file(source, target, settings, progress=progress))
    except Exception as error:
        known = error if isinstance(error, CushionError) else unexpected(error)
        return _failed(source, target, named(known, source))


def _failed(source: Path, target: Path, error: CushionError) -> Rendered:
    return Rendered(source, target, error=str(error), exit_code=error.exit_code)


def _report_one(report_share: ReportShare, item: int, items: int, share: float) -> None:
    report_share((item + share) / items)

"""The thread that owns a connection to the sound server and serves requests of other threads."""

import os
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from device.errors import CushionError, InternalError, LostError, NoAnswerError

ANSWER_LIMIT_S = 2.0  # longest time for one answer; a slower server counts as lost

Result = TypeVar("Result")


class ConnectionThread(ABC):
    """Connects on a new thread, then serves requests until the connection is lost or closed.

    The thread calls the methods that derived classes override, except `_wake_up`.
    lost: why the connection was lost, or None.
    """

    def __init__(self, name: str) -> None:
        self._requests = queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]]()
        self._gate = threading.Lock()  # ensures that every request is either queued or refused
        self._ended = self._stopping = False
        self.lost: LostError | None = None
        ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), name=name, daemon=True)
        self._thread.start()
        try:
            ready.result(2 * ANSWER_LIMIT_S)
        except TimeoutError:
            self._stopping = True
            raise self._no_answer() from None

    def close(self) -> bool:
        """End the connection; return whether it ended in time. May be repeated, by any thread."""
        self._stopping = True
        with self._gate:
            if not self._ended:
                self._wake_up()
        if threading.current_thread() is not self._thread:
            self._thread.join(2 * ANSWER_LIMIT_S)
        return not self._thread.is_alive()

    def _ask(self, work: Callable[[], Result]) -> Result:
        """Run `work` on the connection's thread, which must not call this; return the result."""
        if threading.current_thread() is self._thread:
            raise InternalError("the connection's thread must not query the connection")
        future: Future[Result] = Future()
        with self._gate:
            if self._ended:
                raise self.lost or LostError("the connection to the sound server is closed")
            self._requests.put((future, work))
            self._wake_up()
        try:
            return future.result(2 * ANSWER_LIMIT_S)
        except TimeoutError:
            raise self._no_answer() from None

    @abstractmethod
    def _wake_up(self) -> None:
        """Interrupt the thread's waiting. Any thread that holds `_gate` may call this."""

    @abstractmethod
    def _open(self) -> None:
        """Connect to the server."""

    @abstractmethod
    def _serve(self) -> None:
        """Serve requests until `_stopping` is true; an exception ends the connection."""

    @abstractmethod
    def _disconnect(self) -> None:
        """End the connection, which may already be lost."""

    @abstractmethod
    def _free(self) -> None:
        """Free the resources that `_wake_up` uses. Called while `_gate` is held."""

    def _report_loss(self, error: LostError) -> None:  # noqa: B027
        """Report that an open connection was lost."""

    def _fail(self, future: Future[Any], error: Exception) -> None:
        future.set_exception(error)

    def _run(self, ready: Future[None]) -> None:
        error: CushionError | None = None
        try:
            self._open()
            ready.set_result(None)
            self._serve()
        except CushionError as known:
            error = known
        except Exception as unknown:  # pulsectl has many exceptions for a lost server
            error = LostError(f"the sound server{where()} was lost ({self._reason_of(unknown)})")
        if isinstance(error, LostError) and not self._stopping:
            self.lost = error
        self._disconnect()
        with self._gate:
            self._ended = True
            self._free()
        closed = error or LostError("the connection to the sound server was closed")
        while not self._requests.empty():
            self._requests.get()[0].set_exception(closed)
        if not ready.done():
            ready.set_exception(closed)
        elif self.lost is not None:
            self._report_loss(self.lost)

    def _do_requests(self) -> None:
        while not self._requests.empty():
            future, work = self._requests.get()
            try:
                future.set_result(work())
            except Exception as error:
                self._fail(future, error)

    @staticmethod
    def _reason_of(error: Exception) -> str:
        return ": ".join(filter(None, (type(error).__name__, str(error))))

    def _no_answer(self) -> NoAnswerError:
        return NoAnswerError(
            f"the sound server{where()} does not answer; see whether it hangs, and restart it if so"
        )


def where() -> str:
    """Return " at ADDRESS" if the environment sets a server address, else ""."""
    address = os.environ.get("PULSE_SERVER")
    return f" at {address}" if address else ""


def no_server() -> LostError:
    """Return the error to raise if no sound server answers."""
    needed = ("PULSE_SERVER", "XDG_RUNTIME_DIR")
    cause = "" if any(map(os.environ.get, needed)) else " and XDG_RUNTIME_DIR is not set"
    return LostError(
        f"no sound server answers{where()}{cause}; start PulseAudio or pipewire-pulse, or set "
        f"{'XDG_RUNTIME_DIR to the folder of your session, or ' if cause else ''}"
        "PULSE_SERVER to the address of one that runs"
    )

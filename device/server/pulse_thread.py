"""A connection to the sound server for streams of libpulse, and the one thread that may use it."""

from __future__ import annotations

import itertools
import os
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from device.errors import CushionError, InternalError, LostError
from device.server import libpulse
from device.server.pulse import ANSWER_LIMIT_S
from device.stream.pcms import APPLICATION_ID, APPLICATION_NAME

_ASK_AFTER_S = 1.0
"""If streams run and nothing came for so long, the server is asked for a sign of life."""


@dataclass(frozen=True)
class Playing:
    """A stream that plays, as the server describes it.

    samplerate: Hz. paused: the application holds it at present, "corked" in PulseAudio's words.
    """

    name: str
    samplerate: int
    channels: int
    channel_map: libpulse.ChannelMap
    paused: bool


class PulseThread:
    """Connected from the moment it is made until it is lost or closed.

    server: its address, None for the usual one. lost: why the connection is lost, None while it is
    not; another is made to connect again. Derived classes work on the thread: what they hand to
    `_ask`, and the methods that begin with `_on`.

    Raises
    ------
    LostError
        No server answers there.
    NotFoundError
        The library libpulse is not installed.
    """

    def __init__(self, server: str | None, name: str) -> None:
        self._server = server
        self._library = libpulse.load()
        self._requests: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]]
        self._requests = queue.SimpleQueue()
        self._gate = threading.Lock()  # requests are taken or refused; the loop exists if woken
        self._ended = self._stopping = False
        self._loop: Any = None
        self._context: Any = None
        self._numbers = itertools.count(1)
        self._answers: dict[int, Playing | None] = {}
        self._question = 0  # the one that a silent server was asked, 0 if none
        self._asked_s = self._heard_s = time.monotonic()
        self._info_callback = libpulse.SinkInputCallback(self._take_info)
        self._event_callback = libpulse.EventCallback(self._take_event)
        self.lost: LostError | None = None
        ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), name=name, daemon=True)
        self._thread.start()
        try:
            ready.result(2 * ANSWER_LIMIT_S)
        except TimeoutError:
            self._stopping = True
            raise LostError(self._silence()) from None

    def close(self) -> bool:
        """End the connection and its streams; whether that was done in time. Again too.

        Any thread but the connection's own may call this; it raises nothing.
        """
        self._stopping = True
        with self._gate:
            if not self._ended and self._loop is not None:
                self._library.mainloop_wakeup(self._loop)
        if threading.current_thread() is not self._thread:
            self._thread.join(2 * ANSWER_LIMIT_S)
        return not self._thread.is_alive()

    def _ask(self, work: Callable[[], Any]) -> Any:
        """What this gives on the connection's thread; any other thread may call it."""
        if threading.current_thread() is self._thread:
            raise InternalError("what the connection's thread calls must not ask the connection")
        future: Future[Any] = Future()
        with self._gate:
            if self._ended:
                raise self.lost or LostError("the connection for streams is closed")
            self._requests.put((future, work))
            self._library.mainloop_wakeup(self._loop)
        try:
            return future.result(2 * ANSWER_LIMIT_S)
        except TimeoutError:
            raise LostError(self._silence()) from None

    # ----------------------------------------------------- on the own thread, for derived classes

    def _on_step(self) -> None:
        """Something may have come: read the streams. It must not wait."""

    def _on_round(self) -> None:
        """Between two requests: look after the streams; this may use `_until`."""

    def _on_removed(self, stream_index: int) -> None:
        """A stream that played is gone. Inside libpulse: it must note that, no more."""

    def _on_end(self) -> None:
        """Give all streams up: the last that happens. `lost` says why, None if it was closed."""

    def _streams_run(self) -> bool:
        """Whether streams run, so that a silent server has to be asked."""
        return False

    def _comes(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Whether this comes to hold within limit_s; streams run on meanwhile."""
        deadline_s = time.monotonic() + limit_s
        while not condition():
            if self._stopping:
                raise LostError("the connection for streams is closed")
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return False
            self._step(left_s, for_requests=False)
        return True

    def _until(self, condition: Callable[[], bool]) -> None:
        """Wait for what the server answers at once. LostError: it does not."""
        if not self._comes(condition, ANSWER_LIMIT_S):
            raise LostError(self._silence())

    def _playing(self, stream_index: int) -> Playing | None:
        """The stream that plays with this index, None if there is none."""
        number = self._inquire(stream_index)
        self._until(lambda: number in self._answers)
        return self._answers.pop(number)

    def _reason(self) -> str:
        """Why libpulse has refused the latest call."""
        code = self._library.context_errno(self._context)
        return str(self._library.strerror(code).decode("utf-8", "replace"))

    # ------------------------------------------------------------------------------------ inside

    def _run(self, ready: Future[None]) -> None:
        error: CushionError | None = None
        try:
            self._connect()
            ready.set_result(None)
            while not self._stopping:
                self._step(_ASK_AFTER_S / 2 if self._streams_run() else None)
                self._do_requests()
                self._on_round()
                self._watch(time.monotonic())
        except CushionError as known:
            error = known
        except Exception as unknown:
            error = LostError(f"the connection for streams failed ({unknown!r}); connect again")
        self._end(error, ready)

    def _connect(self) -> None:
        library = self._library
        with self._gate:
            self._loop = library.mainloop_new()
        api = library.mainloop_get_api(self._loop)
        with self._properties({"application.id": APPLICATION_ID}) as properties:
            self._context = library.context_new_with_proplist(
                api, APPLICATION_NAME.encode(), properties
            )
        server = None if self._server is None else self._server.encode()
        flags = libpulse.CONTEXT_NOAUTOSPAWN
        try:
            if library.context_connect(self._context, server, flags, None) < 0:
                raise LostError(self._reason())
            self._until(lambda: library.context_get_state(self._context) == libpulse.CONTEXT_READY)
        except LostError:
            raise LostError(
                f"no sound server answers{self._where()}; start PulseAudio or pipewire-pulse, or "
                "set PULSE_SERVER to the address of one that runs"
            ) from None
        library.context_set_subscribe_callback(self._context, self._event_callback, None)
        events = libpulse.SUBSCRIBE_SINK_INPUTS
        library.operation_unref(library.context_subscribe(self._context, events, None, None))

    def _step(self, limit_s: float | None, for_requests: bool = True) -> None:
        """Wait until something comes, a request too if `for_requests`, and let streams be read."""
        library, loop = self._library, self._loop
        prepared = library.mainloop_prepare(loop, -1 if limit_s is None else int(limit_s * 1e6))
        # preparing has forgotten who woke the loop before
        if self._stopping or (for_requests and not self._requests.empty()):
            library.mainloop_wakeup(loop)
        if prepared < 0 or library.mainloop_poll(loop) < 0:
            raise LostError(self._silence())
        if library.mainloop_dispatch(loop) > 0:
            self._heard_s = time.monotonic()
        if library.context_get_state(self._context) >= libpulse.CONTEXT_FAILED:
            raise LostError(f"the sound server{self._where()} was lost ({self._reason()})")
        self._on_step()

    def _do_requests(self) -> None:
        while not self._requests.empty():
            future, work = self._requests.get()
            try:
                future.set_result(work())
            except Exception as error:  # for the thread that asked
                future.set_exception(error)

    def _watch(self, now_s: float) -> None:
        """Ask a silent server for a sign of life; one that hangs looks like one that is silent."""
        if self._question in self._answers:
            del self._answers[self._question]
            self._question = 0
        if not self._streams_run() or now_s - self._heard_s < _ASK_AFTER_S:
            return
        if not self._question:
            self._asked_s, self._question = now_s, self._inquire(0)
        elif now_s - self._asked_s > ANSWER_LIMIT_S:
            raise LostError(self._silence())

    def _inquire(self, stream_index: int) -> int:
        """Ask for a stream that plays; the number under which `_answers` is going to have it."""
        number = next(self._numbers)
        operation = self._library.context_get_sink_input_info(
            self._context, stream_index, self._info_callback, number
        )
        if not operation:
            raise LostError(f"the sound server{self._where()} was lost ({self._reason()})")
        self._library.operation_unref(operation)
        return number

    def _take_info(self, context: Any, info: Any, end: int, number: int) -> None:
        if end:
            self._answers.setdefault(number, None)
            return
        found = info.contents
        self._answers[number] = Playing(
            (found.name or b"").decode("utf-8", "replace"),
            found.sample_spec.rate,
            found.sample_spec.channels,
            libpulse.ChannelMap.from_buffer_copy(found.channel_map),
            bool(found.corked),
        )

    def _take_event(self, context: Any, what: int, index: int, _: Any) -> None:
        if what & libpulse.EVENT_MASK == libpulse.EVENT_SINK_INPUT_REMOVED:
            self._on_removed(index)

    def _end(self, error: CushionError | None, ready: Future[None]) -> None:
        if isinstance(error, LostError) and not self._stopping:
            self.lost = error
        self._on_end()
        if self._context is not None:
            self._library.context_disconnect(self._context)
            self._library.context_unref(self._context)
        with self._gate:
            self._ended = True
            loop, self._loop = self._loop, None
        if loop is not None:
            self._library.mainloop_free(loop)
        closed = error or LostError("the connection for streams was closed")
        while not self._requests.empty():
            self._requests.get()[0].set_exception(closed)
        if not ready.done():
            ready.set_exception(closed)

    @contextmanager
    def _properties(self, values: Mapping[str, str]) -> Iterator[Any]:
        """A property list of libpulse, for the time of this context."""
        properties = self._library.proplist_new()
        for name, value in values.items():
            self._library.proplist_sets(properties, name.encode(), value.encode())
        try:
            yield properties
        finally:
            self._library.proplist_free(properties)

    def _where(self) -> str:
        address = self._server or os.environ.get("PULSE_SERVER")
        return f" at {address}" if address else ""

    def _silence(self) -> str:
        return (
            f"the sound server{self._where()} does not answer; see whether it hangs, and restart "
            "it if so"
        )

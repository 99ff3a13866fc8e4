"""A connection to the sound server for streams of libpulse that record."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from device.errors import LostError
from device.server import libpulse
from device.server.connection_thread import ANSWER_LIMIT_S, ConnectionThread, no_server, where
from device.stream.pcms import APPLICATION_ID, APPLICATION_NAME

_QUERY_AFTER_S = 1.0
"""With open streams, a server that is silent for this long gets a query as a sign of life."""


@dataclass(frozen=True)
class PlayingStream:
    """A stream that plays, as the server describes it.

    samplerate: Hz. paused: held by the application ("corked").
    """

    name: str
    samplerate: int
    channels: int
    channel_map: libpulse.ChannelMap
    paused: bool


class RecordConnection(ConnectionThread):
    """The connection and its event loop. Derived classes keep the streams.

    They work on the connection's thread: in requests for `_ask`, and in the `_on...` methods.
    """

    def __init__(self, name: str) -> None:
        self._library = libpulse.load()
        self._loop: Any = None
        self._context: Any = None
        self._numbers = itertools.count(1)
        self._answers: dict[int, PlayingStream | None] = {}
        self._query = 0  # number of the query to a silent server, or 0
        self._queried_s = self._heard_s = time.monotonic()
        self._info_callback = libpulse.SinkInputCallback(self._take_info)
        self._event_callback = libpulse.EventCallback(self._take_event)
        super().__init__(name)

    # -------------------------------------------------------------------- for derived classes

    def _on_step(self) -> None:
        """Read the streams, which may have frames. It must not wait."""
        raise NotImplementedError

    def _on_round(self) -> None:
        """Maintain the streams between two requests. It may wait for answers."""
        raise NotImplementedError

    def _on_removed(self, stream_index: int) -> None:
        """Note that a playing stream is gone. Called inside libpulse."""
        raise NotImplementedError

    def _on_end(self) -> None:
        """Give up all streams; `lost` says why, None if the connection was closed."""
        raise NotImplementedError

    def _has_streams(self) -> bool:
        """Whether streams are open, so that a silent server must be queried."""
        raise NotImplementedError

    def _wait_for(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Wait until the condition holds, limit_s at most; whether it does. Streams continue."""
        deadline_s = time.monotonic() + limit_s
        while not condition():
            if self._stopping:
                raise LostError("the connection to the sound server is closed")
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return False
            self._step(left_s, for_requests=False)
        return True

    def _wait_for_answer(self, condition: Callable[[], bool]) -> None:
        if not self._wait_for(condition, ANSWER_LIMIT_S):
            raise self._no_answer()

    def _find_playing(self, stream_index: int) -> PlayingStream | None:
        """Query the playing stream with this index; None if there is none."""
        number = self._send_query(stream_index)
        self._wait_for_answer(lambda: number in self._answers)
        return self._answers.pop(number)

    def _reason(self) -> str:
        """Return why libpulse refused the latest call."""
        code = self._library.context_errno(self._context)
        return str(self._library.strerror(code).decode("utf-8", "replace"))

    @contextmanager
    def _properties(self, values: Mapping[str, str]) -> Iterator[Any]:
        """Provide a property list of libpulse inside this context."""
        properties = self._library.proplist_new()
        for name, value in values.items():
            self._library.proplist_sets(properties, name.encode(), value.encode())
        try:
            yield properties
        finally:
            self._library.proplist_free(properties)

    # ------------------------------------------------------------------------------------ inside

    def _wake_up(self) -> None:
        if self._loop is not None:
            self._library.mainloop_wakeup(self._loop)

    def _open(self) -> None:
        library = self._library
        with self._gate:
            self._loop = library.mainloop_new()
        api = library.mainloop_get_api(self._loop)
        with self._properties({"application.id": APPLICATION_ID}) as properties:
            self._context = library.context_new_with_proplist(
                api, APPLICATION_NAME.encode(), properties
            )
        flags, ready = libpulse.CONTEXT_NOAUTOSPAWN, libpulse.CONTEXT_READY
        try:
            if library.context_connect(self._context, None, flags, None) < 0:
                raise LostError(self._reason())
            self._wait_for_answer(lambda: library.context_get_state(self._context) == ready)
        except LostError:
            raise no_server() from None
        library.context_set_subscribe_callback(self._context, self._event_callback, None)
        events = libpulse.SUBSCRIBE_SINK_INPUTS
        library.operation_unref(library.context_subscribe(self._context, events, None, None))

    def _serve(self) -> None:
        while not self._stopping:
            self._step(_QUERY_AFTER_S / 2 if self._has_streams() else None)
            self._do_requests()
            self._on_round()
            self._check_silence(time.monotonic())

    def _step(self, limit_s: float | None, for_requests: bool = True) -> None:
        """Wait for the server, and for requests if `for_requests`; then read the streams."""
        library, loop = self._library, self._loop
        prepared = library.mainloop_prepare(loop, -1 if limit_s is None else int(limit_s * 1e6))
        # preparing clears earlier wake-ups
        if self._stopping or (for_requests and not self._requests.empty()):
            library.mainloop_wakeup(loop)
        if prepared < 0 or library.mainloop_poll(loop) < 0:
            raise self._no_answer()
        if library.mainloop_dispatch(loop) > 0:
            self._heard_s = time.monotonic()
        if library.context_get_state(self._context) >= libpulse.CONTEXT_FAILED:
            raise LostError(f"the sound server{where()} was lost ({self._reason()})")
        self._on_step()

    def _check_silence(self, now_s: float) -> None:
        """Query a silent server, to tell whether it hangs."""
        if self._query in self._answers:
            del self._answers[self._query]
            self._query = 0
        if not self._has_streams() or now_s - self._heard_s < _QUERY_AFTER_S:
            return
        if not self._query:
            self._queried_s, self._query = now_s, self._send_query(0)
        elif now_s - self._queried_s > ANSWER_LIMIT_S:
            raise self._no_answer()

    def _send_query(self, stream_index: int) -> int:
        """Query a playing stream; returns the key of the answer in `_answers`."""
        number = next(self._numbers)
        operation = self._library.context_get_sink_input_info(
            self._context, stream_index, self._info_callback, number
        )
        if not operation:
            raise LostError(f"the sound server{where()} was lost ({self._reason()})")
        self._library.operation_unref(operation)
        return number

    def _take_info(self, context: Any, info: Any, end: int, number: int) -> None:
        if end:
            self._answers.setdefault(number, None)
            return
        found = info.contents
        self._answers[number] = PlayingStream(
            (found.name or b"").decode("utf-8", "replace"),
            found.sample_spec.rate,
            found.sample_spec.channels,
            libpulse.ChannelMap.from_buffer_copy(found.channel_map),
            bool(found.corked),
        )

    def _take_event(self, context: Any, what: int, index: int, _: Any) -> None:
        if what & libpulse.EVENT_MASK == libpulse.EVENT_SINK_INPUT_REMOVED:
            self._on_removed(index)

    def _disconnect(self) -> None:
        self._on_end()
        if self._context is not None:
            self._library.context_disconnect(self._context)
            self._library.context_unref(self._context)

    def _free(self) -> None:
        loop, self._loop = self._loop, None
        if loop is not None:
            self._library.mainloop_free(loop)

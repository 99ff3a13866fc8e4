"""A connection to the sound server beside the streams: what it holds, what changes, what to change.

pulsectl belongs to one thread here, which waits for events, looks again after them and does what
others ask for. Nothing of pulsectl is called inside its event callback, nor by another thread.
Both kinds of server speak this protocol: PulseAudio, and PipeWire by its pipewire-pulse.
"""

from __future__ import annotations

import math
import os
import queue
import select
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, TypeVar

from device.errors import CushionError, InternalError, LostError, NotFoundError
from device.server.defaults_check import Defaults, DefaultsCheck
from device.server.snapshot import (
    DEFAULT_SETTLES_S,
    Event,
    Listener,
    ServerSnapshot,
    keep_samplerates,
    take_snapshot,
)
from device.volume_limit import limit_volume_db

ANSWER_LIMIT_S = 2.0
"""How long a server may take for one answer; then it counts as lost."""

_LOOK_AGAIN_S = 0.02
"""Events come in dozens: they are gathered for so long before everything is asked for again."""

Result = TypeVar("Result")


class PulseConnection:
    """A connection to a server; connected from the moment it is made until it is lost or closed.

    server: its address, None for the usual one. Another is made to connect again: `backoff_s`
    says when. renewals: how often it was made anew by itself, see `second_opinion`. Any thread but
    the connection's own may call the methods.

    Raises
    ------
    LostError
        No server answers there; here, and in every method once it is lost.
    NotFoundError
        The library libpulse is not installed.
    """

    def __init__(self, *listeners: Listener, server: str | None = None) -> None:
        self._server = server
        self._listeners: list[Listener] = list(listeners)
        self._requests: queue.SimpleQueue[tuple[Future[Any], Callable[[Any], Any]]]
        self._requests = queue.SimpleQueue()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._stopping = False
        self._gate = threading.Lock()  # requests are taken or refused, never forgotten
        self._ended = False
        self._deadline_s: float | None = None
        self._pulse: Any = None
        self._events = 0
        self._due_s: float | None = None
        self._default_due_s: float | None = None
        self._default_seen = self._default_told = ""
        self._opinion = DefaultsCheck(server, self._disagreed)
        self.reconnects = 0
        self.lost: LostError | None = None
        ready: Future[ServerSnapshot] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), name="pulse", daemon=True)
        self._thread.start()
        try:
            self.latest: ServerSnapshot = ready.result(2 * ANSWER_LIMIT_S)
            """The latest snapshot; read by any thread."""
        except TimeoutError:
            self._stopping = True
            raise LostError(self._silence()) from None

    # ---------------------------------------------------------------------------------- asking

    def snapshot(self) -> ServerSnapshot:
        """Everything as it is now; `latest` is what was known without asking."""
        return self._ask(lambda _: self._refresh())

    def move_source_output(self, index: int, source_index: int) -> None:
        """Lead a recording stream to another source. NotFoundError: one of them is gone."""
        self._ask(lambda pulse: pulse.source_output_move(index, source_index))

    def move_sink_input(self, index: int, sink_index: int) -> None:
        """Lead a playing stream to another sink. NotFoundError: one of them is gone."""
        self._ask(lambda pulse: pulse.sink_input_move(index, sink_index))

    def mute_sink_input(self, index: int, mute: bool) -> None:
        """Mute a playing stream, or let it be heard. NotFoundError: it is gone."""
        self._ask(lambda pulse: pulse.sink_input_mute(index, mute))

    def set_sink_input_volume(self, index: int, volume: float) -> None:
        """Set all channels of a playing stream; 1.0 leaves samples as they are."""

        def work(pulse: Any) -> None:
            stream = pulse.sink_input_info(index)
            pulse.volume_set_all_chans(stream, volume)

        self._ask(work)

    def set_sink_volume_db(self, name: str, wanted_db: float) -> None:
        """Set all channels of a sink, 0 dB at most, and lift its mute. NotFoundError: it is gone.

        The server's scale: 60 log10 of its own number, 1.0 at 0 dB (its `pa_sw_volume_from_dB`).
        Raises UsageError where wanted_db is no number.
        """
        volume = 10.0 ** (limit_volume_db(wanted_db, -math.inf, name) / 60.0)

        def work(pulse: Any) -> None:
            sink = pulse.get_sink_by_name(name)
            pulse.volume_set_all_chans(sink, volume)
            pulse.sink_mute(sink.index, False)

        self._ask(work)

    def set_default_sink(self, name: str) -> None:
        """Make a sink the default one, as a user would. NotFoundError: there is none of this name.

        PulseAudio moves the streams that follow the default at once, WirePlumber some 50 ms later.
        """
        self._ask(lambda pulse: pulse.sink_default_set(name))

    def load_module(self, name: str, arguments: Sequence[str] = ()) -> int:
        """Load a module into the server; its index. NotFoundError: the server has none or fails."""
        try:
            return int(self._ask(lambda pulse: pulse.module_load(name, list(arguments))))
        except NotFoundError:
            raise NotFoundError(
                f"the sound server does not load {name}; see whether it has it, takes its "
                "arguments and allows modules to be loaded"
            ) from None

    def unload_module(self, index: int) -> None:
        """Unload a module of the server. NotFoundError: it is gone."""
        self._ask(lambda pulse: pulse.module_unload(index))

    def modules(self) -> dict[int, str]:
        """The names of the server's modules, by index."""
        return {
            module.index: module.name for module in self._ask(lambda pulse: pulse.module_list())
        }

    def add(self, listener: Listener) -> None:
        """Tell this listener as well, beginning with what is known now."""

        def work(_: Any) -> None:
            self._listeners.append(listener)
            self._refresh()

        self._ask(work)

    def remove(self, listener: Listener) -> None:
        """Tell this listener no longer; nothing happens if it was not told, or all is lost."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    def close(self) -> None:
        """End the connection; again too. It raises nothing and `on_lost` is not called."""
        self._stopping = True
        self._rouse()
        if threading.current_thread() is not self._thread:
            self._thread.join(2 * ANSWER_LIMIT_S)

    def _ask(self, work: Callable[[Any], Result]) -> Result:
        if threading.current_thread() is self._thread:
            raise InternalError("a listener must not ask the connection that calls it")
        future: Future[Result] = Future()
        with self._gate:
            if self._ended:
                raise self.lost or LostError("the connection to the sound server is closed")
            self._requests.put((future, work))
            os.eventfd_write(self._wake, 1)
        try:
            return future.result(2 * ANSWER_LIMIT_S)
        except TimeoutError:
            raise LostError(self._silence()) from None

    def _rouse(self) -> None:
        with self._gate:
            if not self._ended:
                os.eventfd_write(self._wake, 1)

    # ---------------------------------------------------------------------- on the own thread

    def _run(self, ready: Future[ServerSnapshot]) -> None:
        error: CushionError | None = None
        try:
            self._connect()
            self._refresh()
            self._default_told = self.latest.default_sink
            self._default_due_s = None
            ready.set_result(self.latest)
            self._serve()
        except CushionError as known:
            error = known
        except Exception as unknown:  # pulsectl's many ways to say that the server is gone
            error = LostError(f"the sound server{self._where()} was lost ({_reason(unknown)})")
        self._end(error, ready)

    def _connect(self) -> None:
        try:
            import pulsectl
        except (ImportError, OSError) as error:
            raise NotFoundError(
                f"the library libpulse cannot be loaded ({error}); install it (libpulse0)"
            ) from None
        keep_samplerates(pulsectl)
        self._deadline_s = time.monotonic() + ANSWER_LIMIT_S
        try:
            self._pulse = pulsectl.Pulse("haptic-cushion", server=self._server, connect=False)
            self._pulse.set_poll_func(self._poll, lambda *_: None)
            self._pulse.connect()
        except Exception:
            raise LostError(
                f"no sound server answers{self._where()}; start PulseAudio or pipewire-pulse, or "
                "set PULSE_SERVER to the address of one that runs"
            ) from None
        self._pulse.event_mask_set("all")
        self._pulse.event_callback_set(self._on_event)
        self._deadline_s = None

    def _serve(self) -> None:
        while not self._stopping:
            self._do_requests()
            now_s = time.monotonic()
            if self._due_s is not None and now_s >= self._due_s:
                self._refresh()
                continue
            if self._default_due_s is not None and now_s >= self._default_due_s:
                self._default_due_s = None
                if self._default_seen != self._default_told:
                    self._default_told = self._default_seen
                    for listener in tuple(self._listeners):
                        listener.on_default_sink(self._default_told)
            self._opinion.seek(now_s, self.latest)
            times_s = (self._due_s, self._default_due_s, self._opinion.due_s)
            due = [due_s for due_s in times_s if due_s is not None]
            self._pulse.event_listen(max(min(due) - now_s, 0.001) if due else None)

    def _do_requests(self) -> None:
        while not self._requests.empty():
            future, work = self._requests.get()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                with _Within(self):
                    result = work(self._pulse)
            except Exception as error:
                if not self._pulse.connected:
                    future.set_exception(LostError(self._silence()))
                    raise
                future.set_exception(
                    error
                    if isinstance(error, CushionError)
                    else NotFoundError(
                        f"the sound server does not do it ({_reason(error)}): the stream, device "
                        "or module is gone or not available"
                    )
                )
            else:
                future.set_result(result)

    def _refresh(self) -> ServerSnapshot:
        """Ask for everything and tell it; events that come meanwhile make it due again."""
        self._due_s = None
        with _Within(self):
            snapshot = take_snapshot(self._pulse, self._events)
        self.latest = snapshot
        for listener in tuple(self._listeners):
            listener.on_snapshot(snapshot)
        if snapshot.default_sink != self._default_seen:
            self._default_seen = snapshot.default_sink
            self._default_due_s = time.monotonic() + DEFAULT_SETTLES_S
        self._opinion.changed(time.monotonic(), snapshot)
        return snapshot

    def _disagreed(self, known: Defaults) -> None:
        """Connect again, if it is still told that; what listens does not notice. Any thread."""
        with suppress(CushionError):  # it has ended meanwhile
            self._ask(lambda _: self._renew(known))

    def _renew(self, known: Defaults) -> None:
        if Defaults.of(self._refresh()) == known:
            self.reconnects += 1
            self._pulse.close()
            self._connect()
            self._refresh()

    def _on_event(self, info: Any) -> None:
        """Inside libpulse: note it, pass it on, call nothing of pulsectl."""
        self._events += 1
        event = Event(str(info.facility._value), str(info.t._value), info.index, self._events)
        urgent = False
        for listener in tuple(self._listeners):
            urgent = listener.on_event(event) or urgent
        due_s = time.monotonic() + (0.0 if urgent else _LOOK_AGAIN_S)
        if urgent or (event.facility != "client" and self._due_s is None):
            self._due_s = due_s if self._due_s is None else min(due_s, self._due_s)
            self._pulse.event_listen_stop()  # on this thread: it only leaves the loop

    def _poll(self, descriptors: Sequence[Any], timeout_s: float) -> int:
        """In libpulse's place: wait for its descriptors, for requests and for the deadline."""
        poller = select.poll()
        for item in descriptors:
            poller.register(item.fd, item.events)
        poller.register(self._wake, select.POLLIN)
        left_ms = timeout_s * 1000.0 if timeout_s >= 0.0 else -1.0
        if self._deadline_s is not None:
            until_ms = max((self._deadline_s - time.monotonic()) * 1000.0, 0.0)
            left_ms = until_ms if left_ms < 0.0 else min(left_ms, until_ms)
        found = dict(poller.poll(left_ms if left_ms >= 0.0 else None))
        if found.pop(self._wake, 0):
            os.eventfd_read(self._wake)
            self._pulse.event_listen_stop()
        for item in descriptors:
            item.revents = found.get(item.fd, 0)
        if self._deadline_s is not None and time.monotonic() >= self._deadline_s and not found:
            self._pulse.close()  # leaves libpulse's loop first
        return len(found)

    def _end(self, error: CushionError | None, ready: Future[ServerSnapshot]) -> None:
        if self._pulse is not None:
            self._deadline_s = None
            with suppress(Exception):  # what is lost cannot be closed properly
                self._pulse.close()
            self._pulse = None
        with self._gate:
            self._ended = True
            if isinstance(error, LostError) and not self._stopping:
                self.lost = error
            os.close(self._wake)
        closed = error or LostError("the connection to the sound server was closed")
        while not self._requests.empty():
            future, _ = self._requests.get()
            if future.set_running_or_notify_cancel():
                future.set_exception(closed)
        if not ready.done():
            ready.set_exception(closed)
        elif self.lost is not None:
            for listener in tuple(self._listeners):
                listener.on_lost(self.lost)

    def _where(self) -> str:
        address = self._server or os.environ.get("PULSE_SERVER")
        return f" at {address}" if address else ""

    def _silence(self) -> str:
        return (
            f"the sound server{self._where()} does not answer; see whether it hangs, and restart "
            "it if so"
        )


class _Within:
    """A time limit for what the server is asked inside this context."""

    def __init__(self, connection: PulseConnection) -> None:
        self._connection = connection

    def __enter__(self) -> None:
        self._connection._deadline_s = time.monotonic() + ANSWER_LIMIT_S

    def __exit__(self, *error: object) -> None:
        self._connection._deadline_s = None


def _reason(error: Exception) -> str:
    text = str(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__

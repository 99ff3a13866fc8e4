"""A control connection to PulseAudio or PipeWire: snapshots, events and changes.

One thread owns the pulsectl object. This thread takes snapshots after events and serves requests of
other threads. The object is never used inside pulsectl's event callback or on another thread.
"""

import math
import os
import select
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Any

from device.errors import CushionError, LostError, NotFoundError
from device.server.connection_thread import ANSWER_LIMIT_S, ConnectionThread, Result, no_server
from device.server.defaults_check import Defaults, DefaultsCheck
from device.server.libpulse import load_pulsectl
from device.server.snapshot import (
    DEFAULT_SETTLES_S,
    STREAMS,
    Event,
    Listener,
    ServerSnapshot,
    patch_pulsectl,
    take_snapshot,
)
from device.volume_limit import limit_volume_db

CLIENT = "haptic-cushion"  # name of these connections on the server
FACILITIES = ("sink", "source", "sink_input", "source_output", "module", "card", "server")
_GATHER_S = 0.02  # time from the first event of a group to the snapshot; events come in dozens
_BUSY_POLLS, _BUSY_S = 50, 1.0  # after 50 polls in 1 s, each event waits for further events
_REST_RATIO = 100.0  # pause after a snapshot / duration of the snapshot: about 1 % of a core
_REST_MAX_S = 2.0  # longest such pause; only snapshots for events about streams wait for its end
_SAVED_S = 10.0  # this much unused pause allows snapshots in quick succession: a game starts
_VOLUME_LOOKS, _VOLUME_LOOK_S = 25, 0.02
_VOLUME_ROUNDING = 1e-4  # between six and seven of the server's 65 536 volume steps


class PulseConnection(ConnectionThread):
    """A connection that lasts from its construction until it is lost or closed.

    Any thread except its own may call the methods. They raise NotFoundError if a stream, device or
    module is gone. listeners: see `Listener`. latest: the latest snapshot; any thread may read it.
    lost: None, or why the connection was lost. After a loss, make a new object. LostError: no
    server answers or the server was lost. NotFoundError: pulsectl or libpulse is not installed.
    """

    latest: ServerSnapshot

    def __init__(self, *listeners: Listener) -> None:
        self._listeners: list[Listener] = list(listeners)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._deadline_s: float | None = None
        self._polls_s = deque([-_BUSY_S], maxlen=_BUSY_POLLS)
        self._pulse: Any = None
        self._events = 0
        self._changed: set[str] = set()
        self._rested_s = -_SAVED_S
        self._due_s: float | None = None
        self._default_due_s: float | None = None
        self._default_seen = ""
        self._check = DefaultsCheck(self._on_outdated)
        super().__init__("pulse")

    def snapshot(self) -> ServerSnapshot:
        """Query the server and return a new snapshot."""
        return self._ask(self._refresh)

    def move_source_output(self, index: int, source_index: int) -> None:
        """Move a recording stream to another source."""
        self._ask(lambda: self._pulse.source_output_move(index, source_index))

    def move_sink_input(self, index: int, sink_index: int) -> None:
        """Move a playing stream to another sink."""
        self._ask(lambda: self._pulse.sink_input_move(index, sink_index))

    def set_sink_volume_db(self, name: str, wanted_db: float) -> None:
        """Set all channels of a sink to wanted_db, at most 0 dB; then unmute the sink.

        NotFoundError: the sink is gone, or its volume stays too high. UsageError: wanted_db is NaN.
        """
        volume = 10.0 ** (limit_volume_db(wanted_db, -math.inf, name) / 60.0)  # see `decibels`

        def find() -> Any:
            return self._pulse.get_sink_by_name(name)

        self._ask(lambda: self._pulse.volume_set_all_chans(find(), volume))
        for _ in range(_VOLUME_LOOKS):  # PipeWire answers before it has set the volume
            if max(self._ask(find).volume.values, default=0.0) <= volume + _VOLUME_ROUNDING:
                self._ask(lambda: self._pulse.sink_mute(find().index, False))
                return
            time.sleep(_VOLUME_LOOK_S)
        raise NotFoundError(f"the sink {name!r} does not take the level {wanted_db:g} dB")

    def set_sink_mute(self, name: str, muted: bool) -> None:
        """Mute a sink, or unmute it at its present volume."""
        self._ask(lambda: self._pulse.sink_mute(self._pulse.get_sink_by_name(name).index, muted))

    def set_default_sink(self, name: str) -> None:
        """Make a sink the default sink. Streams may move to it later."""
        self._ask(lambda: self._pulse.sink_default_set(name))

    def load_module(self, name: str, arguments: Sequence[str] = ()) -> int:
        """Load a module into the server and return its index."""
        try:
            return int(self._ask(lambda: self._pulse.module_load(name, list(arguments))))
        except NotFoundError:
            raise NotFoundError(
                f"the sound server does not load {name}; check that it has this module, accepts "
                "its arguments and allows modules to be loaded"
            ) from None

    def unload_module(self, index: int) -> None:
        """Unload a module of the server."""
        self._ask(lambda: self._pulse.module_unload(index))

    def modules(self) -> dict[int, str]:
        """Return the names of the server's modules, keyed by index."""
        return {one.index: one.name for one in self._ask(lambda: self._pulse.module_list())}

    def has_device(self, name: str) -> bool:
        """Return whether the server has a sink or source with this name now."""
        lists = self._ask(lambda: (*self._pulse.sink_list(), *self._pulse.source_list()))
        return any(one.name == name for one in lists)

    def latencies_s(self) -> dict[str, float]:
        """Return each sink's present latency in seconds, keyed by name. PipeWire reports 0."""
        return {one.name: 1e-6 * one.latency for one in self._ask(lambda: self._pulse.sink_list())}

    def processes(self) -> set[int]:
        """Return the ids of the processes that have such a connection, of this process too."""
        clients = self._ask(lambda: self._pulse.client_list())
        texts = (
            one.proplist.get("application.process.id", "") for one in clients if one.name == CLIENT
        )
        return {int(text) for text in texts if text.isdecimal()}

    def add(self, listener: Listener) -> None:
        """Add a listener, which gets a snapshot at once."""

        def work() -> None:
            self._listeners.append(listener)
            self._refresh()

        self._ask(work)

    def remove(self, listener: Listener) -> None:
        """Remove a listener. Removing an unknown listener has no effect."""
        with suppress(ValueError):
            self._listeners.remove(listener)

    def _ask(self, work: Callable[[], Result]) -> Result:
        def timed() -> Result:
            with self._deadline():
                return work()

        return super()._ask(timed)

    def _wake_up(self) -> None:
        os.eventfd_write(self._wake, 1)

    # ------------------------------------------------------------------ on the connection's thread

    def _open(self) -> None:
        self._connect()
        self._refresh()
        self._default_due_s = None

    def _connect(self) -> None:
        pulsectl = load_pulsectl()
        patch_pulsectl(pulsectl)
        with self._deadline():
            try:
                self._pulse = pulsectl.Pulse(CLIENT, connect=False)
                self._pulse.set_poll_func(self._poll, lambda *_: None)
                self._pulse.connect()
            except Exception:
                is_late = time.monotonic() >= (self._deadline_s or math.inf)
                raise (self._no_answer() if is_late else no_server()) from None
            self._pulse.event_mask_set(*FACILITIES)
            self._pulse.event_callback_set(self._on_event)

    def _serve(self) -> None:
        while not self._stopping:
            self._do_requests()
            now_s = time.monotonic()
            if self._due_s is not None and now_s >= self._due_s:
                self._refresh()
                continue
            if self._default_due_s is not None and now_s >= self._default_due_s:
                self._default_due_s = None
                for listener in tuple(self._listeners):
                    listener.on_default_sink(self._default_seen)
            self._check.check_if_due(now_s, self.latest)
            times_s = (self._due_s, self._default_due_s, self._check.due_s)
            due = [due_s for due_s in times_s if due_s is not None]
            self._pulse.event_listen(max(min(due) - now_s, 0.001) if due else None)

    def _fail(self, future: Future[Any], error: Exception) -> None:
        if not self._pulse.connected:
            future.set_exception(self._no_answer())
            raise error
        if not isinstance(error, CushionError):
            error = NotFoundError(
                f"the sound server refuses ({self._reason_of(error)}): the stream, device or "
                "module is gone or not available"
            )
        future.set_exception(error)

    def _refresh(self) -> ServerSnapshot:
        """Take and report a snapshot; events during the query cause another snapshot."""
        began_s, self._due_s = time.monotonic(), None
        changed, self._changed = self._changed, set()
        known = self.latest if changed and changed <= STREAMS else None
        with self._deadline():
            self.latest = snapshot = take_snapshot(self._pulse, self._events, known)
        now_s = time.monotonic()
        rest_s = _REST_RATIO * (now_s - began_s)
        self._rested_s = min(max(self._rested_s, now_s - _SAVED_S) + rest_s, now_s + _REST_MAX_S)
        if self._due_s is not None and self._due_s > now_s and self._changed <= STREAMS:
            self._due_s = max(self._due_s, self._rested_s)  # events came during the query
        for listener in tuple(self._listeners):
            listener.on_snapshot(snapshot)
        if snapshot.default_sink != self._default_seen:
            self._default_seen = snapshot.default_sink
            self._default_due_s = time.monotonic() + DEFAULT_SETTLES_S
        self._check.note_change(time.monotonic(), snapshot)
        return snapshot

    def _on_outdated(self, known: Defaults) -> None:
        """Connect again if the defaults are still outdated. Other threads call this."""

        def reconnect() -> None:
            seen = self._refresh()
            if (seen.default_sink, seen.default_source) == known:
                self._pulse.close()
                self._connect()
                self._refresh()

        with suppress(CushionError):  # the connection has ended
            self._ask(reconnect)

    def _on_event(self, info: Any) -> None:
        """Count and report an event. This runs inside libpulse, so queries are forbidden."""
        self._events += 1
        event = Event(str(info.facility._value), str(info.t._value), info.index, self._events)
        urgent = False
        for listener in tuple(self._listeners):
            urgent = listener.on_event(event) or urgent
        self._changed.add(event.facility)
        now_s = time.monotonic()
        due_s = now_s if urgent else now_s + _GATHER_S
        if not urgent and event.facility in STREAMS:
            due_s = max(due_s, self._rested_s)
        if self._due_s is None or due_s < self._due_s:
            self._due_s = due_s
            self._pulse.event_listen_stop()  # only sets a flag that ends libpulse's loop

    def _poll(self, descriptors: Sequence[Any], timeout_s: float) -> int:
        """Replace libpulse's poll: wait for its file descriptors, requests or the deadline."""
        poller = select.poll()
        for item in descriptors:
            poller.register(item.fd, item.events)
        poller.register(self._wake, select.POLLIN)
        waits_s = [timeout_s] if timeout_s >= 0.0 else []
        if self._deadline_s is not None:
            waits_s.append(max(self._deadline_s - time.monotonic(), 0.0))
        elif time.monotonic() - self._polls_s[0] < _BUSY_S:
            wake = select.poll()
            wake.register(self._wake, select.POLLIN)
            wake.poll(1000.0 * min([_GATHER_S, *waits_s]))
            waits_s = [0.0] if waits_s else []
        found = dict(poller.poll(1000.0 * min(waits_s) if waits_s else None))
        self._polls_s.append(time.monotonic())
        if found.pop(self._wake, 0):
            os.eventfd_read(self._wake)
            self._pulse.event_listen_stop()
        for item in descriptors:
            item.revents = found.get(item.fd, 0)
        if self._deadline_s is not None and time.monotonic() >= self._deadline_s and not found:
            self._pulse.close()  # leaves libpulse's loop before it closes the connection
        return len(found)

    @contextmanager
    def _deadline(self) -> Iterator[None]:
        self._deadline_s = time.monotonic() + ANSWER_LIMIT_S
        try:
            yield
        finally:
            self._deadline_s = None

    def _disconnect(self) -> None:
        if self._pulse is not None:
            self._deadline_s = None
            with suppress(Exception):  # a lost connection cannot be closed properly
                self._pulse.close()
            self._pulse = None

    def _free(self) -> None:
        os.close(self._wake)

    def _report_loss(self, error: LostError) -> None:
        for listener in tuple(self._listeners):
            listener.on_lost(error)

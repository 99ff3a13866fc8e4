"""Guards our streams: no vibration on another sink, and no microphone as input.

A server that loses a device moves its streams to another one without notice. A guard silences its
stream at the first event about it. On PulseAudio a fallback sink also catches the queued frames
(about 10 ms), which move before the event arrives: PulseAudio prefers it for our role of stream. On
PipeWire the output ends instead (see `pcms`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum

from device.errors import LostError, NotFoundError
from device.server.identity import find_tagged
from device.server.pulse import PulseConnection
from device.server.snapshot import Event, Listener, ServerSnapshot
from device.stream.pcms import FALLBACK_SINK, ROLE
from device.stream.streams import CaptureStream, PlaybackStream


class Hold(Enum):
    """Whether the stream may be audible; the value says why."""

    FREE = "the stream is where it belongs"
    UNSETTLED = "an event about the stream is not checked yet"
    NO_STREAM = "the server does not have the stream, or it has no device yet"
    NO_DEVICE = "its sink or monitor is gone"
    ELSEWHERE = "the stream is on another device"
    LOST = "the server is not connected"

    @property
    def audible(self) -> bool:
        """Whether the stream may be audible."""
        return self is Hold.FREE

    @property
    def misplaced(self) -> bool:
        """Whether the stream is not on its device, as for a few ms after any underrun."""
        return self in (Hold.NO_STREAM, Hold.NO_DEVICE, Hold.ELSEWHERE)


@dataclass(frozen=True)
class StreamPlacement:
    """Knowledge of one stream; `after_...` returns updated knowledge, `hold` judges it.

    name: of the device where it belongs: a sink, a monitor or any source. stream, device: their
    indexes. on: index of the stream's present device. unsettled: number of the event that is not
    checked yet, or 0.
    """

    tag: str
    name: str
    plays: bool = True
    connected: bool = False
    stream: int | None = None
    device: int | None = None
    on: int | None = None
    unsettled: int = 0
    any_source: bool = False

    @property
    def hold(self) -> Hold:
        """The decision."""
        if not self.connected:
            return Hold.LOST
        if self.device is None:
            return Hold.NO_DEVICE
        if self.stream is None or self.on is None:
            return Hold.NO_STREAM
        if self.on != self.device:
            return Hold.ELSEWHERE
        return Hold.UNSETTLED if self.unsettled else Hold.FREE

    def after_event(self, event: Event) -> StreamPlacement:
        """Return the knowledge after an event, before any query."""
        stream, device = ("sink_input", "sink") if self.plays else ("source_output", "source")
        gone = event.kind == "remove"
        if event.facility == stream and event.index == self.stream:
            if gone:
                return replace(self, stream=None, on=None, unsettled=event.number)
            return replace(self, unsettled=event.number)
        if event.facility == device and event.index == self.device and gone:
            return replace(self, device=None, unsettled=event.number)
        return self

    def may_be_back(self, event: Event) -> bool:
        """Whether this event may be about our missing stream: one was made."""
        stream = "sink_input" if self.plays else "source_output"
        return self.stream is None and event.facility == stream and event.kind == "new"

    def after_snapshot(self, snapshot: ServerSnapshot) -> StreamPlacement:
        """Return the knowledge after a snapshot; one older than the event changes nothing."""
        if snapshot.events < self.unsettled:
            return self
        streams = snapshot.sink_inputs if self.plays else snapshot.source_outputs
        sources = [one for one in snapshot.sources if one.monitor_of or self.any_source]
        devices = {one.name: one.index for one in (snapshot.sinks if self.plays else sources)}
        stream = find_tagged(streams, self.tag)
        return replace(
            self,
            connected=True,
            stream=None if stream is None else stream.index,
            device=devices.get(self.name),
            on=None if stream is None else stream.device_index,
            unsettled=0,
        )

    def after_loss(self) -> StreamPlacement:
        """Return the knowledge after the loss of the server."""
        return replace(self, connected=False, stream=None, device=None, on=None)


class StreamGuard(Listener):
    """Silences a stream unless it is known to be on its device.

    It alone sets `stream.audible`. Any thread but the connection's may use it; any thread may read
    `hold`, the present decision, and call `misplaced_s`.

    connection: reports where the stream is. stream: to silence. device_name: of the haptic sink
    for a `PlaybackStream`, of a monitor for a `CaptureStream`. any_source: whether device_name may
    be any source, for measurements.
    """

    def __init__(
        self,
        connection: PulseConnection,
        stream: PlaybackStream | CaptureStream,
        device_name: str,
        *,
        any_source: bool = False,
    ) -> None:
        self._connection, self._stream = connection, stream
        self._lock = threading.Lock()
        self._released = False
        plays = isinstance(stream, PlaybackStream)
        placement = StreamPlacement(stream.tag, device_name, plays, any_source=any_source)
        self._misplaced_at_s: float | None = None
        self._judge(lambda: placement)
        connection.add(self)

    def misplaced_s(self, now_s: float) -> float:
        """Return how long the stream has been misplaced; now_s is time.monotonic()."""
        began_s = self._misplaced_at_s
        return 0.0 if began_s is None else max(0.0, now_s - began_s)

    def retarget(self, device_name: str) -> None:
        """Change the stream's device; afterwards let the server move the stream."""
        self._judge(lambda: replace(self._placement, name=device_name, device=None))
        self._connection.snapshot()

    def release(self) -> None:
        """End the guard and silence the stream. May be repeated; raises nothing."""
        with self._lock:
            self._released = True
            self._stream.audible = False
        self._connection.remove(self)

    def on_event(self, event: Event) -> bool:
        """Silence the stream at once if this event may have moved it."""
        self._judge(lambda: self._placement.after_event(event))
        placement = self._placement
        return placement.unsettled == event.number or placement.may_be_back(event)

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Check where the stream is."""
        self._judge(lambda: self._placement.after_snapshot(snapshot))

    def on_lost(self, error: LostError) -> None:
        """Silence the stream, as its moves are not reported any more."""
        self._judge(lambda: self._placement.after_loss())

    def _judge(self, change: Callable[[], StreamPlacement]) -> None:
        with self._lock:
            self._placement = change()
            self.hold = self._placement.hold
            self._stream.audible = self.hold.audible and not self._released
            if not self.hold.misplaced:
                self._misplaced_at_s = None
            elif self._misplaced_at_s is None:
                self._misplaced_at_s = time.monotonic()


class FallbackSink:
    """The silent sink that PulseAudio moves our stream to if its own sink vanishes.

    Make it before the playback stream. One that an earlier process left is taken over. Any thread
    but the connection's uses it.

    connection: to the server. active: whether the sink is ready. reason: why not, in one line.
    LostError: the connection is lost.
    """

    def __init__(self, connection: PulseConnection) -> None:
        self._connection = connection
        self._modules: list[int] = []
        self.active, self.reason = False, ""
        snapshot = connection.snapshot()
        if snapshot.kind == "PipeWire":
            self.reason = "PipeWire ends the stream instead"
            return
        try:
            if "module-intended-roles" not in connection.modules().values():
                self._modules.append(connection.load_module("module-intended-roles"))
            modules = {sink.name: sink.module for sink in snapshot.sinks}
            left = modules.get(FALLBACK_SINK)
            if left is None:
                known = f"device.description=Haptic-Cushion-(silent) device.intended_roles={ROLE}"
                arguments = (f"sink_name={FALLBACK_SINK}", f'sink_properties="{known}"')
                left = connection.load_module("module-null-sink", arguments)
            self._modules.append(left)
            self.active = True
        except NotFoundError as error:
            self.reason = (
                f"about 10 ms of vibration may be audible if the haptic device vanishes: {error}"
            )
            self.close()

    def close(self) -> None:
        """Unload our modules. May be repeated; raises nothing."""
        self.active = False
        while self._modules:
            with suppress(LostError, NotFoundError):  # it is gone already
                self._connection.unload_module(self._modules.pop())

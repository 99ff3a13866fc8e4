"""Guards this program's streams: only the haptic sink plays vibration; no microphone is captured.

If a device is lost, the server moves the device's streams to another device without notice. A guard
silences a stream at the first event about it, but frames already queued play on the new device. On
PulseAudio this device is our silent fallback sink, which PulseAudio prefers for our stream's role.
On PipeWire the output ends instead (see `pcms`).
"""

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
    """Whether the stream may be audible; the value is the reason."""

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
        """Whether the stream is not on its own device; also true for some ms after an underrun."""
        return self in (Hold.NO_STREAM, Hold.NO_DEVICE, Hold.ELSEWHERE)


@dataclass(frozen=True)
class StreamPlacement:
    """What is known about one stream. The methods `after_...` return an updated copy.

    name: the stream's own device, the only one on which it may be audible. stream, device: index
    of the stream and of its own device. on: index of the stream's present device. unsettled: number
    of the event that is not checked yet, or 0.
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
        """Whether and why the stream must be silent."""
        if not self.connected:
            return Hold.LOST
        if self.device is None:
            return Hold.NO_DEVICE
        if self.stream is None or self.on is None:
            return Hold.NO_STREAM
        if self.on != self.device:
            return Hold.ELSEWHERE
        return Hold.UNSETTLED if self.unsettled else Hold.FREE

    def after_event(self, event: Event) -> "StreamPlacement":
        """Return a copy updated by an event. The server is not queried."""
        stream, device = ("sink_input", "sink") if self.plays else ("source_output", "source")
        gone = event.kind == "remove"
        if event.facility == stream and event.index == self.stream:
            if gone:
                return replace(self, stream=None, on=None, unsettled=event.number)
            return replace(self, unsettled=event.number)
        if event.facility == device and event.index == self.device and gone:
            return replace(self, device=None, unsettled=event.number)
        return self

    def after_snapshot(self, snapshot: ServerSnapshot) -> "StreamPlacement":
        """Return a copy updated by a snapshot, unless it is older than the event `unsettled`."""
        if snapshot.events < self.unsettled:
            return self
        streams = snapshot.sink_inputs if self.plays else snapshot.source_outputs
        sources = [one for one in snapshot.sources if one.monitor_of or self.any_source]
        devices = {one.name: one.index for one in (snapshot.sinks if self.plays else sources)}
        stream = find_tagged(streams, self.tag)
        index, on = (stream.index, stream.device_index) if stream else (None, None)
        device = devices.get(self.name)
        return replace(self, connected=True, stream=index, device=device, on=on, unsettled=0)

    def after_loss(self) -> "StreamPlacement":
        """Return a copy updated for the loss of the server."""
        return replace(self, connected=False, stream=None, device=None, on=None)


class StreamGuard(Listener):
    """Silences a stream unless it is known to be on its own device.

    Only the guard sets `stream.audible`. Any thread except the connection's may call the methods.
    Any thread may read `hold`, the present decision, and call `misplaced_s`.
    connection: reports where the stream is. device_name: the stream's own device, which is the
    haptic sink for a `PlaybackStream` and a monitor for a `CaptureStream`. any_source: whether a
    capture may be from a source that is no monitor, for measurements. stream: the stream to guard.
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
        """Return for how many s the stream has been misplaced. now_s: time.monotonic()."""
        began_s = self._misplaced_at_s
        return 0.0 if began_s is None else max(0.0, now_s - began_s)

    def retarget(self, device_name: str) -> None:
        """Change the stream's own device; silence the stream until it is on this device."""
        self._judge(lambda: replace(self._placement, name=device_name, device=None))
        self.look()

    def look(self) -> None:
        """Ask the server where the stream is. LostError: the server does not answer."""
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
        facility = "sink_input" if placement.plays else "source_output"
        # a new stream while ours is missing may be ours
        is_new = placement.stream is None and (event.facility, event.kind) == (facility, "new")
        return placement.unsettled == event.number or is_new

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Check whether the stream is on its own device."""
        self._judge(lambda: self._placement.after_snapshot(snapshot))

    def on_lost(self, error: LostError) -> None:
        """Silence the stream, because the lost server reports no moves."""
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
    """The silent sink to which PulseAudio moves our stream if the haptic sink vanishes.

    Make this object before the playback stream. A fallback sink that an earlier process left is
    reused. Any thread except the connection's may use the object. connection: to the server.
    reason: why the sink is not ready, in one line; "" on PipeWire, which ends the stream instead.
    LostError: the connection is lost.
    """

    def __init__(self, connection: PulseConnection) -> None:
        self._connection = connection
        self._modules: list[int] = []
        self.reason = ""
        snapshot = connection.snapshot()
        if snapshot.kind == "PipeWire":
            return
        try:
            if "module-intended-roles" not in connection.modules().values():
                self._modules.append(connection.load_module("module-intended-roles"))
            sink = snapshot.sink(FALLBACK_SINK)
            left = sink.module if sink else None
            if left is None:
                known = f"device.description=Haptic-Cushion-(silent) device.intended_roles={ROLE}"
                arguments = (f"sink_name={FALLBACK_SINK}", f'sink_properties="{known}"')
                left = connection.load_module("module-null-sink", arguments)
            self._modules.append(left)
        except NotFoundError as error:
            self.reason = (
                f"about 10 ms of vibration may be audible if the haptic device vanishes: {error}"
            )
            self.close()

    def close(self) -> None:
        """Unload the sink's modules. May be repeated; raises nothing."""
        while self._modules:
            with suppress(LostError, NotFoundError):  # the module is already unloaded
                self._connection.unload_module(self._modules.pop())

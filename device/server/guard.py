"""The hold on our streams: vibration is never heard from another sink, a microphone never felt.

A server that loses a device moves its streams on to another one, without a word to them. Two
measures, since one does not suffice. A guard silences its stream in the same event as something
happens to it, and frees it only once it is known to be where it belongs. And on PulseAudio a refuge
stands by for the output: what is queued there (some 10 ms) moves on with the stream, before anyone
hears of it, and would be played by the default sink. The refuge is a silent sink for our role of
stream, which PulseAudio prefers then. On PipeWire the output ends instead (see `pcms`).
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
from device.server.snapshot import Event, Listener, ServerSnapshot, Sink
from device.stream.pcms import FALLBACK_SINK, ROLE
from device.stream.streams import CaptureStream, PlaybackStream


class Hold(Enum):
    """Whether the stream may be audible, and if not, why."""

    FREE = "the stream is where it belongs"
    UNSETTLED = "something happened to the stream and was not looked at yet"
    NO_STREAM = "the server does not have the stream, or has it nowhere yet"
    NO_DEVICE = "its sink or monitor is gone"
    ELSEWHERE = "the stream is on another device"
    LOST = "there is no connection to the server"

    @property
    def audible(self) -> bool:
        """Whether the stream may be audible."""
        return self is Hold.FREE

    @property
    def misplaced(self) -> bool:
        """Whether the stream is not where it belongs.

        If that lasts, it has to be closed, and opened again once its device is there. For some
        ms it is usual: after an underrun ALSA's plugin gives up the stream and makes another one.
        """
        return self in (Hold.NO_STREAM, Hold.NO_DEVICE, Hold.ELSEWHERE)


@dataclass(frozen=True)
class StreamPlacement:
    """What is known of one stream; a value, changed by `after_...`, judged by `hold`.

    tag: the stream's; name: of the device where it belongs, which is a sink if it plays, else a
    source. Of a source only a monitor counts, unless any_source: for measuring. stream, device:
    their indexes and on: the index of the device that the stream is on, as last seen. unsettled:
    number of the event that has to be looked into, 0 if none.
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
        """What is known once this event has come, before anything was asked."""
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
        """Whether this event may tell of our stream, which is missing: one was made."""
        stream = "sink_input" if self.plays else "source_output"
        return self.stream is None and event.facility == stream and event.kind == "new"

    def is_urgent(self, event: Event) -> bool:
        """Whether it has to be asked at once what this event, which `after_event` had, means."""
        mine = "sink_input" if self.plays else "source_output"
        new = event.kind == "new" and event.facility == mine and self.stream is None
        return new or self.unsettled == event.number

    def after_snapshot(self, snapshot: ServerSnapshot) -> StreamPlacement:
        """What is known once everything was asked for; older snapshots than events are left."""
        if snapshot.events < self.unsettled:
            return self
        streams = snapshot.sink_inputs if self.plays else snapshot.source_outputs
        devices = (
            {sink.name: sink.index for sink in snapshot.sinks}
            if self.plays
            else {
                source.name: source.index
                for source in snapshot.sources
                if source.monitor_of or self.any_source
            }
        )
        stream = find_tagged(streams, self.tag)
        return replace(
            self,
            connected=True,
            stream=None if stream is None else stream.index,
            device=devices.get(self.name),
            on=None if stream is None else stream.place,
            unsettled=0,
        )

    def after_loss(self) -> StreamPlacement:
        """What is known once the server is gone."""
        return replace(self, connected=False, stream=None, device=None, on=None)


class StreamGuard(Listener):
    """Silences a stream unless it is known to be on the device of this name.

    device_name: of the haptic sink for a `PlaybackStream`, of a monitor for a `CaptureStream`, or
    of any source where any_source is True, for measuring.
    It sets `stream.audible` from the moment it is made, and is the only one that may. on_hold:
    called with every change of the decision, by the connection's thread (or by the one that makes
    the guard or calls `retarget`); it must return at once. Any thread but the connection's makes,
    leads and releases it; any thread may read `hold`, the decision at present, and `astray_s`.
    """

    def __init__(
        self,
        connection: PulseConnection,
        stream: PlaybackStream | CaptureStream,
        device_name: str,
        on_hold: Callable[[Hold], None] | None = None,
        *,
        any_source: bool = False,
    ) -> None:
        self._connection = connection
        self._stream = stream
        self._on_hold = on_hold
        self._lock = threading.Lock()
        self._released = False
        plays = isinstance(stream, PlaybackStream)
        self._place = StreamPlacement(stream.tag, device_name, plays, any_source=any_source)
        self.hold = self._place.hold
        self._misplaced_at_s: float | None = None
        self._judge(lambda place: place)
        connection.add(self)

    def misplaced_s(self, now_s: float) -> float:
        """For how long the stream has been misplaced without a break; 0 if it is not.

        now_s: time.monotonic().
        """
        began_s = self._misplaced_at_s
        return 0.0 if began_s is None else max(0.0, now_s - began_s)

    def retarget(self, device_name: str) -> None:
        """From now on the stream belongs elsewhere; call this, then let the server move it."""
        self._judge(lambda place: replace(place, name=device_name, device=None))
        self._connection.snapshot()

    def release(self) -> None:
        """End the guard: the stream is silent from now on. Again too; it raises nothing."""
        with self._lock:
            self._released = True
            self._stream.audible = False
        self._connection.remove(self)

    def on_event(self, event: Event) -> bool:
        """Silence at once whatever this event may have moved, and ask where it is now."""
        self._judge(lambda place: place.after_event(event))
        place = self._place
        return place.unsettled == event.number or place.may_be_back(event)

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """See where the stream is."""
        self._judge(lambda place: place.after_snapshot(snapshot))

    def on_lost(self, error: LostError) -> None:
        """Silence: nobody would tell any more."""
        self._judge(lambda place: place.after_loss())

    def _judge(self, change: Callable[[StreamPlacement], StreamPlacement]) -> None:
        with self._lock:
            before, self._place = self.hold, change(self._place)
            self.hold = self._place.hold
            self._stream.audible = self.hold.audible and not self._released
            if not self.hold.misplaced:
                self._misplaced_at_s = None
            elif self._misplaced_at_s is None:
                self._misplaced_at_s = time.monotonic()
            changed = self.hold is not before and not self._released
        if changed and self._on_hold is not None:
            self._on_hold(self.hold)


class FallbackSink:
    """The silent sink that PulseAudio moves our stream to when its own sink vanishes.

    Make it before the playback stream is opened, close it after that is closed. active: whether
    it stands by; reason: why not, one line. PipeWire does not need it: it is not active there.
    One left over from an earlier process is taken over. Any thread but the connection's calls it.

    Raises
    ------
    LostError
        The connection is lost.
    """

    def __init__(self, connection: PulseConnection) -> None:
        self._connection = connection
        self._modules: list[int] = []
        self.active = False
        self.reason = ""
        snapshot = connection.snapshot()
        if snapshot.kind == "PipeWire":
            self.reason = "PipeWire ends the stream by itself"
            return
        try:
            if "module-intended-roles" not in connection.modules().values():
                self._modules.append(connection.load_module("module-intended-roles"))
            left = _sink_named(snapshot, FALLBACK_SINK)
            self._modules.append(
                left.module
                if left is not None and left.module is not None
                else connection.load_module("module-null-sink", _FALLBACK_ARGUMENTS)
            )
            self.active = True
        except NotFoundError as error:
            self.reason = (
                f"some 10 ms of vibration may be heard if the haptic device vanishes: {error}"
            )
            self.close()

    def close(self) -> None:
        """Take away again what was loaded. Again too; it raises nothing."""
        self.active = False
        while self._modules:
            with suppress(LostError, NotFoundError):  # it went with the server, or before
                self._connection.unload_module(self._modules.pop())


_FALLBACK_ARGUMENTS = (
    f"sink_name={FALLBACK_SINK}",
    f'sink_properties="device.description=Haptic-Cushion-(silent) device.intended_roles={ROLE}"',
)


def _sink_named(snapshot: ServerSnapshot, name: str) -> Sink | None:
    return next((sink for sink in snapshot.sinks if sink.name == name), None)

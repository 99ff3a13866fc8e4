"""The tap of a sink: its monitor, captured, wherever the default goes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from audioflinger_hook.daemon.capture_queue import FrameReceiver
from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
from audioflinger_hook.service.state import Cause, StateKeeper
from audioflinger_hook.sources import TapAddress
from device.errors import LostError, NotFoundError
from device.server import PulseConnection, ServerSnapshot
from device.server.forwarding import reachable_sinks
from device.server.identity import default_monitor, find_tagged, is_cushion_stream, monitor_of
from device.server.snapshot import Source
from device.stream import AudioPriority, CaptureStream
from device.stream.pcms import Pcm, ServerDevice
from device.stream.portaudio import BLOCK_FRAMES
from device.units import Float32Array

LISTENING_FRAMES = 4_096
"""A block while it only listens: 85 ms at 48 kHz, which is what sound then comes late by."""


class SinkInput:
    """Sound of one sink of the server: the default one, or one by name.

    taker: who gets its buffers, on PortAudio's thread. name: of the monitor that is captured,
    None while none is. block_frames: of a callback; priority: what its thread asks for; both of
    streams that are opened from now on. on_heard: called by PortAudio's thread when there is sound
    while it only listens. For the supervising thread alone.
    """

    needs_server = True
    may_rest = True
    ended = False

    def __init__(
        self,
        address: TapAddress,
        pcm: Pcm,
        states: StateKeeper,
        taker: FrameReceiver,
        *,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        on_heard: Callable[[], None] = lambda: None,
    ) -> None:
        self.block_frames = block_frames
        self._on_heard = on_heard
        self._heard = False
        self._priority = priority
        self._asked = False
        self._address = address
        self._pcm = pcm
        self._states = states
        self._taker = taker
        self._kept: ReconnectingStream[CaptureStream] = ReconnectingStream(
            "the tap", states, Cause.TAP_LOST, Cause.TAP_MOVED
        )
        self._ear: ReconnectingStream[CaptureStream] = ReconnectingStream(
            "the tap", states, Cause.TAP_LOST, Cause.TAP_MOVED
        )
        self._found: Source | None = None
        self._source: Source | None = None

    def __str__(self) -> str:
        return str(self._address)

    @property
    def name(self) -> str | None:
        """What is there."""
        return self._source.name if self._source and self._kept.stream else None

    @property
    def xruns(self) -> int:
        """How often PortAudio told of lateness."""
        return self._kept.xruns

    @property
    def tag(self) -> str | None:
        """What the server shows of the stream."""
        return self._kept.stream.tag if self._kept.stream else None

    @property
    def warnings(self) -> list[str]:
        """None."""
        return []

    def lead(self, address: TapAddress) -> None:
        """Go on from another tap, on the same stream if that can be."""
        self._address = address
        self._asked = True

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> Source:
        """Find the monitor to capture, and return it.

        device: the sink that the vibration goes to, which is never tapped, and neither is one that
        it comes to by virtual sinks and loopbacks.

        Raises
        ------
        NotFoundError
            There is none, or it would feed back; nothing else is tapped instead.
        """
        assert snapshot is not None
        if self._address.kind != "sink":
            source = default_monitor(snapshot, device)
        else:
            source = monitor_of(snapshot, self._address.name)
            if source.monitor_of == device:
                raise NotFoundError(
                    f"the tap {str(self)!r} is the sink that the vibration goes to, which would "
                    "feed back; tap another sink"
                )
        if device is not None and source.monitor_of in reachable_sinks(snapshot, device):
            raise NotFoundError(
                f"the server leads what {device!r} plays on to {source.monitor_of!r}, and a tap "
                "there would feed back; tap another sink, or take that connection away"
            )
        self._found = source
        return source

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the applications' streams that may sound in this monitor at any moment."""
        if snapshot is None or self._found is None:
            return frozenset()
        sink = self._found.monitor_of
        return frozenset(
            stream.index
            for stream in snapshot.sink_inputs
            if stream.device_name == sink and not stream.corked and not is_cushion_stream(stream)
        )

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """Return whether sound was heard; listens as long as an application may sound.

        In blocks as long as possible: ten times a second costs next to nothing.
        """
        source = self._found
        if connection is None or source is None or not self.players(connection.latest):
            self._ear.close()
            return False
        heard, self._heard = self._heard, False
        if self._ear.stream is not None and self._source is not source:
            moved = self._source is None or self._source.index != source.index
            if moved:
                self._ear.close()
        self._ear.check(now_s)
        with suppress(LostError, NotFoundError):  # the next look at the server tells
            self._pcm.target = ServerDevice(source.name)
            self._source = source
            self._ear.open(lambda: self._ear_at(source), connection, source.name, now_s)
        return heard

    def keep(self, connection: PulseConnection | None, now_s: float) -> None:
        """Bring the capture nearer to what was located.

        Raises LostError or NotFoundError where it cannot be opened; another try follows.
        """
        kept, source = self._kept, self._found
        assert connection is not None
        assert source is not None
        self._ear.close()
        if kept.stream is not None and self._source is not None:
            if source.name != self._source.name:
                self._lead(connection, source)
            else:
                kept.check(now_s)
        self._asked = False
        if kept.stream is None:
            self._pcm.target = ServerDevice(source.name)
            if self._taker.opened(source.samplerate, source.channels):
                self._states.count(
                    Cause.FORMAT_CHANGED,
                    f"{source.name} has {source.samplerate} Hz, channels: {source.channels}",
                )
            kept.open(lambda: self._capture(source), connection, source.name, now_s)
            self._source = source

    def close(self) -> None:
        """End the capture. Again too; it raises nothing."""
        self._kept.close()
        self._ear.close()

    def end(self, *, keep: bool) -> None:
        """End the capture."""
        self.close()

    def _capture(self, source: Source) -> CaptureStream:
        return CaptureStream(
            self._pcm,
            source.samplerate,
            source.channels,
            self._on_frames,
            audible=False,
            block_frames=self.block_frames,
            priority=self._priority,
        )

    def _ear_at(self, source: Source) -> CaptureStream:
        return CaptureStream(
            self._pcm,
            source.samplerate,
            source.channels,
            self._overhear,
            audible=False,
            block_frames=LISTENING_FRAMES,
        )

    def _overhear(self, frames: Float32Array, now_s: float) -> None:
        """Notice sound; on PortAudio's thread."""
        if frames.any():
            self._heard = True
            self._on_heard()

    def _lead(self, connection: PulseConnection, source: Source) -> None:
        """Let the tap go on from another monitor, on the same stream if the format is the same."""
        stream, guard = self._kept.stream, self._kept.guard
        assert stream is not None
        assert guard is not None
        if not self._asked:
            self._states.count(Cause.DEFAULT_CHANGED, f"the tap goes on from {source.name}")
        served = find_tagged(connection.latest.source_outputs, stream.tag)
        if served is None or (source.samplerate, source.channels) != (
            stream.samplerate,
            stream.channels,
        ):
            self._kept.close()
            return
        guard.retarget(source.name)
        self._taker.moved()
        connection.move_source_output(served.index, source.index)
        self._source = source

    def _on_frames(self, frames: Float32Array, now_s: float) -> None:
        """Take captured frames; on PortAudio's thread."""
        self._taker.push(frames, now_s)

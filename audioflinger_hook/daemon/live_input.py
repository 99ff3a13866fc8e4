"""The tap of a sink: its monitor, captured, wherever the default goes."""

from __future__ import annotations

from audioflinger_hook.clients import TapAddress, TapClient
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.kept import KeptStream
from audioflinger_hook.service.state import Cause, StateKeeper
from audioflinger_hook.taps import PushTap
from device.errors import NotFoundError
from device.server import (
    CaptureStream,
    Pcm,
    PulseConnection,
    ServerSnapshot,
    Sink,
    Source,
    default_monitor,
    is_ours,
    monitor_of,
)
from device.server.identity import tagged
from device.units import Float32Array


class LiveInput:
    """Sound of one sink of the server: the default one, or one by name. For the supervisor alone.

    name: of the monitor that is captured, None while none is.
    """

    def __init__(self, address: TapAddress, pcm: Pcm, states: StateKeeper) -> None:
        self._address = address
        self._pcm = pcm
        self._states = states
        self._kept: KeptStream[CaptureStream] = KeptStream(
            "the tap", states, Cause.TAP_LOST, Cause.TAP_MOVED
        )
        self._source: Source | None = None
        self._tap: PushTap | None = None
        self._client: TapClient | None = None
        self._engine: Engine | None = None

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

    def locate(self, snapshot: ServerSnapshot, device: Sink | None) -> Source:
        """Return the monitor to capture.

        device: where the vibration goes, which is never tapped.

        Raises
        ------
        NotFoundError
            There is none, or it would feed back; nothing else is tapped instead.
        """
        device_name = device.name if device else None
        if self._address.kind != "sink":
            return default_monitor(snapshot, device_name)
        source = monitor_of(snapshot, self._address.name)
        if source.monitor_of == device_name:
            raise NotFoundError(
                f"the tap {str(self)!r} is the sink that the vibration goes to, which would feed "
                "back; tap another sink"
            )
        return source

    def players(self, snapshot: ServerSnapshot, source: Source) -> frozenset[int]:
        """Return the applications' streams that may sound in this monitor at any moment."""
        return frozenset(
            stream.index
            for stream in snapshot.sink_inputs
            if stream.place_name == source.monitor_of and not stream.corked and not is_ours(stream)
        )

    def client(self, source: Source) -> TapClient:
        """Return what plays into the mix, which is of this source's format."""
        self._tap = PushTap(source.samplerate, source.channels)
        self._client = TapClient(self._tap)
        return self._client

    def keep(
        self, connection: PulseConnection, source: Source, engine: Engine, now_s: float
    ) -> None:
        """Bring the capture nearer to where it should be.

        Raises LostError or NotFoundError where it cannot be opened; another try follows.
        """
        kept = self._kept
        if kept.stream is not None and self._source is not None:
            if source.name != self._source.name:
                self._lead(connection, source)
            else:
                kept.check(now_s)
        if kept.stream is None:
            assert self._tap is not None
            self._engine = engine
            self._pcm.lead(source.name)
            if self._tap.change(source.samplerate, source.channels):
                self._states.count(Cause.FORMAT_CHANGED)
            kept.open(lambda: self._capture(source), connection, source.name, now_s)
            self._source = source

    def close(self) -> None:
        """End the capture. Again too; it raises nothing."""
        self._kept.close()

    def _capture(self, source: Source) -> CaptureStream:
        return CaptureStream(
            self._pcm, source.samplerate, source.channels, self._on_frames, audible=False
        )

    def _lead(self, connection: PulseConnection, source: Source) -> None:
        """Let the tap go on from another monitor, on the same stream if the format is the same."""
        stream, guard = self._kept.stream, self._kept.guard
        assert stream is not None
        assert guard is not None
        self._states.count(Cause.DEFAULT_CHANGED)
        served = tagged(connection.latest.source_outputs, stream.tag)
        if served is None or (source.samplerate, source.channels) != (
            stream.samplerate,
            stream.channels,
        ):
            self._kept.close()
            return
        guard.lead(source.name)
        if self._engine:
            self._engine.delay_line.expect_jump()
        connection.move_source_output(served.index, source.index)
        self._source = source

    def _on_frames(self, frames: Float32Array, now_s: float) -> None:
        """Take captured frames; on PortAudio's thread."""
        tap, client, engine = self._tap, self._client, self._engine
        if tap is None or client is None or engine is None or not len(frames):
            return
        tap.push(frames)
        while tap.waiting or client.pending_frames:
            engine.advance(now_s)

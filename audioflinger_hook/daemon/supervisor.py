"""The main thread of the daemon: opens streams, watches them, moves them, opens them again."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.clients import TapAddress
from audioflinger_hook.daemon.engine import IDLE_AFTER_S, Clocks, Engine
from audioflinger_hook.service.backoff import Backoff
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from audioflinger_hook.settings import Settings
from device.address import DeviceAddress
from device.errors import CushionError, LostError, NotFoundError
from device.server import (
    CaptureStream,
    Hold,
    PcmConfig,
    PlaybackStream,
    PulseConnection,
    Refuge,
    ServerSnapshot,
    Sink,
    Source,
    StreamGuard,
    default_monitor,
    monitor_of,
)
from device.server.identity import tagged
from device.units import Float32Array

SETTLES_S = 1.0
"""How long a stream may take from its opening until the server shows it where it belongs."""

ASTRAY_S = 0.4
"""A stream that is elsewhere for less is perhaps being put right by somebody else."""

GONE_S = 3.0
"""The server may be without a stream that runs for so long: one underrun follows another then."""

LONGEST_WAIT_S = 0.5
"""Between attempts to reach the server: asking costs it and us next to nothing."""


class Supervisor:
    """One daemon: from a tap of the sound server to one of its sinks.

    `tick` is called some ten times a second by the thread that made it; times are seconds of
    time.monotonic(). Nothing that a server or device does makes it raise: it waits, recovers and
    says so in `states`. `engine` is what runs at present, None before the first sound.
    """

    def __init__(
        self,
        tap: TapAddress,
        device: DeviceAddress,
        settings: Settings,
        clocks: Clocks,
        *,
        offset_s: float = 0.0,
    ) -> None:
        self._clocks = clocks
        self.states = StateKeeper(clocks.now_s())
        self.engine: Engine | None = None
        self.sink: Sink | None = None
        self.source: Source | None = None
        self._tap = tap
        self._device = device
        self._settings = settings
        self._offset_s = offset_s
        self._pcms = PcmConfig("cushion_tap", "cushion_output")
        self._connection: PulseConnection | None = None
        self._refuge: Refuge | None = None
        self._playback: PlaybackStream | None = None
        self._capture: CaptureStream | None = None
        self._playback_guard: StreamGuard | None = None
        self._capture_guard: StreamGuard | None = None
        self._server_backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._playback_backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._capture_backoff = Backoff(longest_s=LONGEST_WAIT_S)

    @property
    def heard_s(self) -> float:
        """Seconds of sound that came in since the first buffer."""
        return self.engine.frames / self.engine.samplerate if self.engine else 0.0

    @property
    def heard_frames(self) -> int:
        """Frames that came in since the first buffer."""
        return self.engine.frames if self.engine else 0

    @property
    def endpoints(self) -> tuple[tuple[str, str | None], tuple[str, str | None]]:
        """Tap and device: the address asked for, and the name of what is there."""
        source, sink = self.source, self.sink
        return (
            (str(self._tap), source.name if source and self._capture else None),
            (str(self._device), sink.name if sink and self._playback else None),
        )

    @property
    def xruns(self) -> tuple[int, int]:
        """How often the streams of tap and output were late, as far as PortAudio tells."""
        capture, playback = self._capture, self._playback
        return capture.xruns if capture else 0, playback.xruns if playback else 0

    @property
    def warnings(self) -> list[str]:
        """What a user should know, a line each."""
        warnings = list(self.engine.framework.warnings) if self.engine else []
        refuge, connection = self._refuge, self._connection
        if refuge and connection and not refuge.active and connection.latest.kind != "PipeWire":
            warnings.append(refuge.reason)
        return warnings

    def look(self) -> None:
        """See once whether server, device and tap are there.

        Raises
        ------
        LostError, NotFoundError
            The first that is not, with what would help.
        """
        connection = PulseConnection()
        try:
            sink = self._device.sink(connection.latest)
            self._source_of(connection.latest, sink)
        finally:
            connection.close()

    def tick(self, now_s: float) -> None:
        """Bring everything nearer to where it should be."""
        try:
            connection = self._connected(now_s)
            if connection is None:
                return
            sink = self._there(connection, now_s)
            if sink is None:
                return
            source = self._source_of(connection.latest, sink)
        except LostError as error:
            self._lose_server(now_s, str(error))
            return
        except NotFoundError as error:
            self._close_capture()
            self.source = None
            self.states.enter(DaemonState.WAITING_FOR_SOUND_SOURCE, now_s, str(error))
            return
        try:
            self._keep_playback(connection, sink, now_s)
            self._keep_capture(connection, source, sink, now_s)
        except LostError as error:
            if connection.lost:
                self._lose_server(now_s, str(error))
            return
        except NotFoundError:
            return  # it went while we looked; the next snapshot says what to do
        self._name_state(now_s)

    def close(self, now_s: float) -> None:
        """Fall silent and let go of everything."""
        self.states.enter(DaemonState.STOPPING, now_s)
        self._close_playback()
        self._close_capture()
        if self._refuge:
            self._refuge.close()
        if self._connection:
            self._connection.close()
        self._pcms.close()

    def _connected(self, now_s: float) -> PulseConnection | None:
        connection = self._connection
        if connection is not None and connection.lost is None:
            return connection
        if connection is not None:
            self._lose_server(now_s, str(connection.lost))
        if self._server_backoff.wait_s(now_s) > 0.0:
            return None
        try:
            self._connection = connection = PulseConnection()
            self._refuge = Refuge(connection)
        except CushionError as error:
            self._server_backoff.failed(now_s)
            self.states.enter(DaemonState.WAITING_FOR_SERVER, now_s, str(error))
            return None
        self._server_backoff.succeeded()
        return connection

    def _lose_server(self, now_s: float, reason: str) -> None:
        if self._connection is not None:
            self.states.recover(Cause.SERVER_LOST, now_s, reason)
            self._connection.close()
        self._close_playback()
        self._close_capture()
        self._connection = self._refuge = self.sink = self.source = None
        self.states.enter(DaemonState.WAITING_FOR_SERVER, now_s, reason)

    def _there(self, connection: PulseConnection, now_s: float) -> Sink | None:
        """Return the device's sink, or None after saying that it is awaited."""
        try:
            return self._device.sink(connection.latest)
        except NotFoundError as error:
            if self._playback is not None:
                self.states.recover(Cause.DEVICE_LOST, now_s, str(error))
            self._close_playback()
            self.sink = None
            self.states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            return None

    def _source_of(self, snapshot: ServerSnapshot, sink: Sink) -> Source:
        if self._tap.kind == "sink":
            source = monitor_of(snapshot, self._tap.name)
            if source.monitor_of == sink.name:
                raise NotFoundError(
                    f"the tap {str(self._tap)!r} is the sink that the vibration goes to, which "
                    "would feed back; tap another sink"
                )
            return source
        return default_monitor(snapshot, sink.name)

    def _keep_playback(self, connection: PulseConnection, sink: Sink, now_s: float) -> None:
        playback, guard = self._playback, self._playback_guard
        if playback is not None and guard is not None:
            settled = now_s - playback.opened_s > SETTLES_S
            if playback.is_lost(now_s):
                self.states.recover(Cause.DEVICE_LOST, now_s, "the output stopped")
                self._close_playback()
            elif settled and _is_misplaced(guard, now_s):
                self.states.recover(Cause.DEVICE_MOVED, now_s, guard.hold.value)
                self._close_playback()
        if self._playback is None and self._playback_backoff.wait_s(now_s) <= 0.0:
            pcm = self._pcms.pcms["cushion_output"]
            pcm.lead(sink.name)
            try:
                stream = PlaybackStream(pcm, sink.samplerate, sink.channels, self._fill)
                self._playback = stream
                self._playback_guard = StreamGuard(connection, stream, sink.name)
            except CushionError:
                self._playback_backoff.failed(now_s)
                self._close_playback()
                raise
            self._playback_backoff.succeeded()
            self.sink = sink

    def _keep_capture(
        self, connection: PulseConnection, source: Source, sink: Sink, now_s: float
    ) -> None:
        capture, guard = self._capture, self._capture_guard
        if capture is not None and guard is not None:
            settled = now_s - capture.opened_s > SETTLES_S
            if self.source is not None and source.name != self.source.name:
                self._lead_capture(connection, source)
            elif capture.is_lost(now_s):
                self.states.recover(Cause.TAP_LOST, now_s, "the tap stopped")
                self._close_capture()
            elif settled and _is_misplaced(guard, now_s):
                self.states.recover(Cause.TAP_MOVED, now_s, guard.hold.value)
                self._close_capture()
        if self._capture is None and self._capture_backoff.wait_s(now_s) <= 0.0:
            pcm = self._pcms.pcms["cushion_tap"]
            pcm.lead(source.name)
            engine = self._engine_for(source, sink, now_s)
            try:
                stream = CaptureStream(
                    pcm, engine.samplerate, engine.channels, engine.on_frames, audible=False
                )
                self._capture = stream
                self._capture_guard = StreamGuard(connection, stream, source.name)
            except CushionError:
                self._capture_backoff.failed(now_s)
                self._close_capture()
                raise
            self._capture_backoff.succeeded()
            self.source = source

    def _lead_capture(self, connection: PulseConnection, source: Source) -> None:
        """Let the tap go on from another monitor, on the same stream."""
        assert self._capture is not None
        assert self._capture_guard is not None
        self.states.count(Cause.DEFAULT_CHANGED)
        self._capture_guard.lead(source.name)
        stream = tagged(connection.latest.source_outputs, self._capture.tag)
        if stream is None:
            self._close_capture()
            return
        connection.move_source_output(stream.index, source.index)
        self.source = source

    def _engine_for(self, source: Source, sink: Sink, now_s: float) -> Engine:
        """Return the engine, the one there is where it fits: its vibration goes on."""
        engine = self.engine
        wanted = (source.samplerate, source.channels, sink.samplerate)
        if engine is not None and wanted == (
            engine.samplerate,
            engine.channels,
            round(engine.delay_line.samplerate_out),
        ):
            return engine
        if engine is not None:
            self.states.count(Cause.FORMAT_CHANGED)
        self.engine = Engine(
            *wanted, self._settings, clocks=self._clocks, offset_s=self._offset_s, now_s=now_s
        )
        return self.engine

    def _fill(self, out: Float32Array, now_s: float) -> None:
        engine = self.engine
        if engine is None:
            out[:] = np.float32(0.0)
        else:
            engine.fill(out, now_s)

    def _name_state(self, now_s: float) -> None:
        engine = self.engine
        if engine is None or self._capture is None or self._playback is None:
            return
        if now_s - engine.last_sound_s > IDLE_AFTER_S:
            self.states.enter(DaemonState.IDLE, now_s, "nothing plays")
        else:
            self.states.enter(DaemonState.RUNNING, now_s)

    def _close_playback(self) -> None:
        guard, stream = self._playback_guard, self._playback
        self._playback_guard = self._playback = None
        if guard:
            guard.release()
        if stream:
            stream.close()

    def _close_capture(self) -> None:
        guard, stream = self._capture_guard, self._capture
        self._capture_guard = self._capture = None
        if guard:
            guard.release()
        if stream:
            stream.close()


def _is_misplaced(guard: StreamGuard, now_s: float) -> bool:
    """Whether its stream will not come back to its place by itself."""
    return guard.astray_s(now_s) > (GONE_S if guard.hold is Hold.NO_STREAM else ASTRAY_S)

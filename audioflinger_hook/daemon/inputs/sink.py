"""An input that captures the monitor of a named sink or of the default sink."""

from collections.abc import Callable
from contextlib import suppress

from audioflinger_hook.daemon.capture_queue import FrameReceiver
from audioflinger_hook.daemon.inputs.base import Input
from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.state import Cause, StateKeeper
from audioflinger_hook.sources import TapAddress
from device.errors import LostError, NotFoundError
from device.layouts import order_from_alsa
from device.server import PulseConnection, ServerSnapshot
from device.server.forwarding import reachable_sinks
from device.server.identity import default_monitor, find_tagged, is_cushion_stream, monitor_of
from device.server.left_out import LeftOut
from device.server.snapshot import Source
from device.server.tap_volume import TapVolume, monitor_volume_db, muted_sink
from device.stream import AudioPriority, CaptureStream
from device.stream.pcms import Pcm, ServerDevice
from device.stream.portaudio import BLOCK_FRAMES
from device.units import Float32Array

LISTENING_FRAMES = 4_096  # block length while idle: 85 ms at 48 kHz


class SinkInput(Input):
    """Captures the sound of one sink of the server.

    A PortAudio thread calls `receiver.push`. While the daemon is idle, such a thread calls
    `on_heard` for each buffer that is not silent.
    """

    needs_server = may_rest = True  # while idle, `listen` detects sound

    def __init__(
        self,
        address: TapAddress,
        pcm: Pcm,
        states: StateKeeper,
        receiver: FrameReceiver,
        priority: AudioPriority | None = None,
        on_heard: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(str(address))
        self.block_frames = BLOCK_FRAMES
        self._tap, self._pcm, self._states, self._receiver = address, pcm, states, receiver
        self._priority, self._on_heard = priority, on_heard
        self._heard = self._retargeted = False
        self._capture, self._listener = (
            ReconnectingStream[CaptureStream]("the tap", states, Cause.TAP_LOST, Cause.TAP_MOVED)
            for _ in range(2)
        )
        self._volume = TapVolume()
        self._found: Source | None = None
        self._source: Source | None = None
        self._muted = ""

    @property
    def name(self) -> str | None:
        """Name of the captured monitor, None while closed."""
        return self._source.name if self._source and self._capture.stream else None

    @property
    def xruns(self) -> int:
        """See `Endpoint`."""
        return self._capture.xruns

    @property
    def warnings(self) -> list[str]:
        """One warning if the sink is muted or at 0 %, so that its sound causes no vibration."""
        if not self._muted:
            return []
        return [
            f"{self._muted} is muted or at 0 %, so its sound causes no vibration; unmute it, and "
            "set a low volume instead, which does not change the vibration"
        ]

    def configure(self, config: RunConfig) -> None:
        """Store the block length for streams that are opened later."""
        self.block_frames = config.live.block_frames

    def retarget(self, config: RunConfig) -> bool:
        """Capture another sink from the next `maintain` on. See `Endpoint`."""
        if config.rules is not None:
            return False
        self._tap, self.address = config.tap, str(config.tap)
        self._retargeted = True
        return True

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> Source:
        """Return the monitor. NotFoundError: it is missing, or its capture would cause feedback."""
        assert snapshot is not None
        if self._tap.kind != "sink":
            source = default_monitor(snapshot, device)
        else:
            source = monitor_of(snapshot, self._tap.name)
            if source.monitor_of == device:
                raise NotFoundError(
                    f"the tap {str(self)!r} is the sink that the vibration goes to, which would "
                    "feed back; tap another sink"
                )
        if device is not None and source.monitor_of in reachable_sinks(snapshot, device):
            raise NotFoundError(
                f"the server forwards what {device!r} plays to {source.monitor_of!r}, and a tap "
                "there would feed back; tap another sink, or remove that connection"
            )
        self._found = source
        self._muted = muted_sink(snapshot, source.monitor_of)
        return source

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the indexes of other programs' streams that play to the sink."""
        if snapshot is None or self._found is None:
            return frozenset()
        playing = snapshot.playing_to(self._found.monitor_of)
        return frozenset(stream.index for stream in playing if not is_cushion_stream(stream))

    def volume_db(self, snapshot: ServerSnapshot, left_out: LeftOut | None = None) -> float:
        """Return the volume in dB that stream, sink and monitor apply to the captured sound."""
        players = self.players(snapshot)
        if left_out is not None:
            players -= left_out.of(snapshot)
        return self._volume.follow(snapshot, players, self._found)

    def monitor_db(self, snapshot: ServerSnapshot) -> float:
        """Return the volume in dB that sink and monitor apply to the captured sound."""
        return monitor_volume_db(snapshot, self._found) if self._found else 0.0

    def is_muted(self, snapshot: ServerSnapshot) -> bool:
        """Whether the sink is muted or at 0 %."""
        return bool(self._found and muted_sink(snapshot, self._found.monitor_of))

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """Listen while a stream plays; return whether sound has arrived since the last call."""
        source = self._found
        if connection is None or source is None or not self.players(connection.latest):
            self._listener.close()
            return False
        heard, self._heard = self._heard, False
        if self._listener.stream and (not self._source or self._source.index != source.index):
            self._listener.close()
        self._listener.check(now_s)
        with suppress(LostError, NotFoundError):  # the next snapshot shows what happened
            self._pcm.target = ServerDevice(source.name)
            self._source = source
            self._listener.open(
                lambda: self._stream(source, self._notice, LISTENING_FRAMES, None),
                connection,
                source.name,
                now_s,
            )
        return heard

    def maintain(self, connection: PulseConnection | None, now_s: float) -> None:
        """Open, check, move or reopen the capture. For errors, see `Input.maintain`."""
        capture, source = self._capture, self._found
        assert connection is not None
        assert source is not None
        self._listener.close()
        if capture.stream is not None and self._source is not None:
            if source.name != self._source.name:
                self._move(connection, source)
            else:
                capture.check(now_s)
        self._retargeted = False
        if capture.stream is None:
            self._pcm.target = ServerDevice(source.name)
            if self._receiver.opened(source.samplerate, source.channels):
                self._states.count(
                    Cause.FORMAT_CHANGED,
                    f"{source.name} has {source.samplerate} Hz, channels: {source.channels}",
                )
            capture.open(
                # PortAudio's thread calls the receiver directly.
                lambda: self._stream(
                    source, self._receiver.push, self.block_frames, self._priority
                ),
                connection,
                source.name,
                now_s,
            )
            self._source = source

    def close(self) -> None:
        """Close the capture. Repeated calls do nothing."""
        self._capture.close()
        self._listener.close()

    def _stream(
        self,
        source: Source,
        on_frames: Callable[[Float32Array, float], None],
        block_frames: int,
        priority: AudioPriority | None,
    ) -> CaptureStream:
        return CaptureStream(
            self._pcm,
            source.samplerate,
            source.channels,
            on_frames,
            audible=False,
            block_frames=block_frames,
            priority=priority,
            order=order_from_alsa(source.channels),
        )

    def _notice(self, frames: Float32Array, now_s: float) -> None:
        if frames.any():
            self._heard = True
            self._on_heard()

    def _move(self, connection: PulseConnection, source: Source) -> None:
        stream, guard = self._capture.stream, self._capture.guard
        assert stream is not None
        assert guard is not None
        if not self._retargeted:
            self._states.count(Cause.DEFAULT_CHANGED, f"the tap moves to {source.name}")
        served = find_tagged(connection.latest.source_outputs, stream.tag)
        form = stream.samplerate, stream.channels
        if served is None or (source.samplerate, source.channels) != form:
            self._capture.close()
            return
        guard.retarget(source.name)
        self._receiver.moved()
        connection.move_source_output(served.index, source.index)
        self._source = source

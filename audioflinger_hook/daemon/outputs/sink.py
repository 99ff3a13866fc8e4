"""The vibration's way to one sink of the sound server, and to no other."""

from __future__ import annotations

from contextlib import suppress

from audioflinger_hook.daemon.device_volume import DeviceVolume, SetVolume
from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.sides import Actuated, Fill
from audioflinger_hook.service.state import Cause, StateKeeper
from device.address import DeviceAddress
from device.drive import ChannelRouter
from device.drive.channel_positions import sink_channel_map
from device.errors import NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.server.snapshot import Sink, output_latency_s
from device.stream import AudioPriority, PlaybackStream
from device.stream.pcms import Pcm, ServerDevice
from device.stream.portaudio import BLOCK_FRAMES
from device.units import Float32Array


class SinkOutput:
    """A sink of the server that is the haptic device. For the supervisor alone.

    recording: takes what is sent. name: of the sink that is played to, None while none is.
    block_frames: of a callback; priority: what its thread asks for; both of streams that are
    opened from now on; volume: the device's own. actuators: what hangs at its channels.
    """

    needs_server = True
    may_rest = True
    summary = ""

    def __init__(
        self,
        address: DeviceAddress,
        pcm: Pcm,
        states: StateKeeper,
        recording: RunRecording | None = None,
        *,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        volume: DeviceVolume | None = None,
        actuators: Actuated = (),
    ) -> None:
        self.block_frames = block_frames
        self._router = ChannelRouter(actuators)
        self._haptic_channels = 1
        self._priority = priority
        self.volume = volume or DeviceVolume()
        self._address = address
        self._pcm = pcm
        self._recording = recording
        self._kept: ReconnectingStream[PlaybackStream] = ReconnectingStream(
            "the output", states, Cause.DEVICE_LOST, Cause.DEVICE_MOVED
        )
        self._found: Sink | None = None
        self._sink: Sink | None = None

    def __str__(self) -> str:
        return str(self._address)

    @property
    def name(self) -> str | None:
        """What is there."""
        return self._sink.name if self._sink and self._kept.stream else None

    @property
    def xruns(self) -> int:
        """How often PortAudio told of lateness."""
        return self._kept.xruns

    @property
    def tag(self) -> str | None:
        """What the server shows of the stream."""
        return self._kept.stream.tag if self._kept.stream else None

    @property
    def is_open(self) -> bool:
        """Whether a stream plays, or did until a moment ago."""
        return self._kept.stream is not None

    @property
    def warnings(self) -> list[str]:
        """Why the volume is not what was asked for."""
        return [self.volume.warning] if self.volume.warning else []

    def lead(self, address: DeviceAddress) -> None:
        """Fall silent, and go on at another device."""
        self.close()
        self._address = address

    def refuse(self, actuators: Actuated) -> None:
        """Raise UsageError if the sink has no channels for these actuators."""
        if self._found is not None:
            sink_channel_map(self._found, actuators)

    def wire(self, actuators: Actuated) -> None:
        """Take these actuators, without a gap where as many go on."""
        channel_map = None
        if self._sink is not None:
            with suppress(UsageError):  # another device is to follow
                channel_map = sink_channel_map(self._sink, actuators, self._haptic_channels)
        if not self._router.change(actuators, channel_map):
            self.close()

    def suit(self, samplerate: int, channels: int) -> None:
        """Be told the vibration's channels; a sink has a rate of its own."""
        self._haptic_channels = channels

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return what the server adds."""
        if snapshot is None or self._found is None:
            return 0.0
        return output_latency_s(snapshot, self.block_frames, self._found.samplerate)

    def locate(self, snapshot: ServerSnapshot | None) -> Sink:
        """Find the sink.

        NotFoundError: it is not there, or has no channels for the actuators; no other is taken
        instead.
        """
        assert snapshot is not None
        found = self._address.sink(snapshot)
        try:
            sink_channel_map(found, self._router.actuators)
        except UsageError as error:
            raise NotFoundError(str(error)) from None
        self._found = found
        return found

    def keep(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Bring the playback nearer to what was located.

        Raises LostError or NotFoundError where it cannot be opened; another try follows.
        """
        kept, sink = self._kept, self._found
        assert connection is not None
        assert sink is not None
        if kept.stream is not None and self._sink is not None:
            if sink.index != self._sink.index:  # plugged in again: another sink of the same name
                kept.close()
            else:
                kept.check(now_s)
        set_volume = _set_volume_of(connection, sink)
        if kept.stream is not None:
            self.volume.follow(set_volume)
        if kept.stream is None:
            self._pcm.target = ServerDevice(sink.name)
            kept.open(
                lambda: self._playback(sink, fill, set_volume),
                connection,
                sink.name,
                now_s,
            )
            self._sink = sink

    def close(self) -> None:
        """Fall silent. Again too; it raises nothing."""
        self._kept.close()

    def end(self, *, keep: bool) -> None:
        """Fall silent."""
        self.close()

    def _playback(self, sink: Sink, fill: Fill, set_volume: SetVolume) -> PlaybackStream:
        self.volume.set(set_volume)
        recording = self._recording
        sent = None
        if recording is not None:
            recording.reopened()

            def sent(frames: Float32Array, now_s: float) -> None:
                recording.sent(frames, sink.samplerate, now_s)

        channel_map = sink_channel_map(sink, self._router.actuators, self._haptic_channels)
        fill = self._router.connect(fill, channel_map, self.block_frames)
        return PlaybackStream(
            self._pcm,
            sink.samplerate,
            sink.channels,
            fill,
            sent,
            block_frames=self.block_frames,
            priority=self._priority,
        )


def _set_volume_of(connection: PulseConnection, sink: Sink) -> SetVolume:
    def set_volume(wanted_db: float) -> None:
        connection.set_sink_volume_db(sink.name, wanted_db)

    return set_volume

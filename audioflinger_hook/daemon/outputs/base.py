"""The supervisor's interface of all outputs, and the base of outputs with a PortAudio stream."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Generic, TypeVar

from audioflinger_hook.daemon.inputs.base import AudioNode, Endpoint
from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from device.address import DeviceAddress
from device.alsa.offers import MeasuredRate
from device.drive import ActuatorSettings, ChannelMap
from device.drive.channel_router import ChannelRouter
from device.errors import CushionError, LostError, NotFoundError, UsageError
from device.rig import rig_by_name
from device.server import PulseConnection, ServerSnapshot
from device.stream import AudioPriority, PlaybackStream
from device.stream.pcms import Pcm
from device.stream.portaudio import BLOCK_FRAMES
from device.stream.sample_format import SampleFormat
from device.units import Float32Array

# Called with (out, now_s); writes the frames to play next into `out`.
Fill = Callable[[Float32Array, float], None]
# Sets a device to a level in dB and unmutes it; raises CushionError, still muted, if not.
SetVolume = Callable[[float], object]
NodeT = TypeVar("NodeT", bound=AudioNode)


class Output(Endpoint):
    """Where vibration goes."""

    address: DeviceAddress
    may_rest = True

    @property
    def is_open(self) -> bool:
        """Whether the output plays, or did until a moment ago."""
        return self.name is not None

    @property
    def summary(self) -> str:
        """One line about the whole run, usually empty."""
        return ""

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return the delay of a frame after it was written, 0 if unknown."""
        return 0.0

    def measure_rate(self) -> MeasuredRate | None:
        """Return the rate of the device's own clock; None if unknown. Any thread may call it."""
        return None

    def configure(self, config: RunConfig) -> None:
        """Use the config's actuators now, and its stream settings for streams opened later."""
        self.set_actuators(config.settings.actuators)

    @abstractmethod
    def locate(self, snapshot: ServerSnapshot | None) -> AudioNode:
        """Find the device. NotFoundError: it is not available. No other device is used instead."""

    def set_volume(self, connection: PulseConnection | None) -> None:
        """Set the located device's volume if the config has one. NotFoundError: it cannot be."""

    @abstractmethod
    def set_format(self, samplerate: int, channels: int) -> None:
        """Set the rate of the mix in Hz and the channels of the vibration, before `maintain`."""

    @abstractmethod
    def check_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Raise UsageError if the device lacks channels for these actuators."""

    @abstractmethod
    def set_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Take actuators that `check_actuators` accepted.

        Playing stops until the next `maintain` if their number or the open channels change.
        """

    @abstractmethod
    def maintain(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Open, check or reopen the stream to the located device.

        LostError, NotFoundError: the next call tries again; other errors are final.
        """

    def end(self, *, keep: bool) -> None:
        """Close for good; keep: whether a written file stays. WriteError: it cannot be kept."""
        self.close()


class StreamOutput(Output, Generic[NodeT]):
    """An output with a PortAudio stream, on a sink or a card; a recording receives the frames."""

    is_card = False

    def __init__(
        self,
        address: DeviceAddress,
        pcm: Pcm,
        states: StateKeeper,
        recording: RunRecording | None = None,
        *,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        actuators: Sequence[ActuatorSettings] = (),
    ) -> None:
        super().__init__(address)
        self.block_frames = block_frames
        self.volume = DeviceVolume()
        self._pcm, self._priority = pcm, priority
        self._states, self._recording = states, recording
        self._router = ChannelRouter(actuators)
        self._stream = ReconnectingStream[PlaybackStream](
            "the output", states, Cause.DEVICE_LOST, Cause.DEVICE_MOVED
        )
        self._haptic_channels = 1
        self._found: NodeT | None = None
        self._playing: NodeT | None = None

    @property
    def name(self) -> str | None:
        """Name of the open device."""
        return self._playing.name if self._playing and self._stream.stream else None

    @property
    def xruns(self) -> int:
        """Count of late buffers that PortAudio reported."""
        return self._stream.xruns

    @property
    def warnings(self) -> list[str]:
        """Why the volume differs from the configured one."""
        return [self.volume.warning] if self.volume.warning else []

    def configure(self, config: RunConfig) -> None:
        """Take block length, volume and actuators."""
        self.block_frames = config.live.block_frames
        self.volume.request(config)
        super().configure(config)

    def retarget(self, config: RunConfig) -> bool:
        """Play to another sink, or to another card."""
        if config.device_is_a_card != self.is_card:
            return False
        self.close()
        self.address = config.device
        return True

    def set_format(self, samplerate: int, channels: int) -> None:
        """Set the channels of the vibration; a device has its own rate."""
        self._haptic_channels = channels

    def set_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Take these actuators; see `Output`."""
        channel_map = None
        if self._playing is not None:
            with suppress(UsageError):  # another device follows
                channel_map = self._channel_map(self._playing, actuators)
        if not self._router.change(actuators, channel_map):
            self.close()

    def close(self) -> None:
        """Stop. May be repeated; raises nothing."""
        self._stream.close()

    def set_volume(self, connection: PulseConnection | None) -> None:
        """Set the located device's volume if the config has one. NotFoundError: it cannot be."""
        assert self._found is not None
        self.volume.set(self._volume_setter(self._found, connection))

    @abstractmethod
    def _volume_setter(self, node: NodeT, connection: PulseConnection | None) -> SetVolume:
        """Return what sets this device's volume."""

    @contextmanager
    def _waiting(self, now_s: float) -> Iterator[None]:
        """Close, and wait for the device, if it is missing or its volume cannot be set."""
        try:
            yield
        except NotFoundError as error:
            self.close()
            self._states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            raise

    @abstractmethod
    def _channel_map(self, node: NodeT, actuators: Sequence[ActuatorSettings]) -> ChannelMap:
        """Return which actuator each channel of this device plays; raises UsageError."""

    def _playback(
        self,
        node: NodeT,
        fill: Fill,
        set_volume: SetVolume,
        sample_format: SampleFormat = SampleFormat.FLOAT32,
    ) -> PlaybackStream:
        """Return a new stream to this device; the device's volume is set first."""
        self.volume.set(set_volume)
        sent: Callable[[Float32Array, float], None] | None = None
        if self._recording is not None:
            self._recording.reopened()
            sent = partial(self._recording.sent, samplerate=node.samplerate)
        channel_map = self._channel_map(node, self._router.actuators)
        return PlaybackStream(
            self._pcm,
            node.samplerate,
            node.channels,
            self._router.connect(fill, channel_map, self.block_frames),
            sent,
            block_frames=self.block_frames,
            priority=self._priority,
            sample_format=sample_format,
        )


class DeviceVolume:
    """The device's own volume, set when the device is opened. For the supervising thread alone.

    wanted_db: 0 or less, None for no change. limit_db: of the rig. warning: why the volume is below
    `wanted_db`, or "".
    """

    def __init__(self, wanted_db: float | None = None, limit_db: float = 0.0) -> None:
        self.wanted_db, self.limit_db = wanted_db, limit_db
        self.warning = ""
        self._last: tuple[float | None, float] | None = None, limit_db

    def request(self, config: RunConfig) -> None:
        """Store the config's volume; `update` sets it."""
        settings = config.settings
        rigs = {actuator.rig or settings.rig for actuator in settings.actuators} or {settings.rig}
        self.wanted_db = config.live.device_volume_db
        # All channels have one volume, so the most sensitive rig sets the limit.
        self.limit_db = min(rig_by_name(rig).dac.volume_limit_db for rig in rigs)

    def set(self, set_volume: SetVolume) -> None:
        """Set the volume before the device plays. NotFoundError: it cannot be; play nothing."""
        self._last, self.warning = None, ""
        wanted_db = self.wanted_db
        if wanted_db is not None and wanted_db > self.limit_db:
            self.warning = (
                f"device_volume_db = {wanted_db:g}: the rig allows at most "
                f"{self.limit_db:g} dB, which is set instead"
            )
        try:
            if wanted_db is not None:
                set_volume(min(wanted_db, self.limit_db))
        except LostError:
            raise
        except CushionError as error:
            raise NotFoundError(
                f"device_volume_db = {wanted_db:g} cannot be set, so nothing is played and a "
                f"mute stays: {error}; choose another level, or --device-volume-db off, which "
                "plays with the device's own level and mute"
            ) from None
        self._last = (wanted_db, self.limit_db)

    def update(self, set_volume: SetVolume) -> None:
        """Set the volume if the config changed; changes made elsewhere stay. Raises as `set`."""
        if (self.wanted_db, self.limit_db) != self._last:
            self.set(set_volume)

"""Interface of all outputs, and the base class of outputs with a PortAudio stream."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from operator import attrgetter
from typing import Any, Generic, TypeVar

from audioflinger_hook.daemon.inputs.base import AudioNode, Endpoint
from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
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
from device.stream.pcms import Pcm, Target
from device.stream.sample_format import SampleFormat
from device.units import Float32Array

# Called with (out, now_s); writes the frames to play next into `out`.
Fill = Callable[[Float32Array, float], None]
# Sets a device's volume in dB and unmutes the device. CushionError: the volume cannot be set.
SetVolume = Callable[[float], object]
NodeT = TypeVar("NodeT", bound=AudioNode)


class Output(Endpoint):
    """A destination of the vibration."""

    address: DeviceAddress
    may_rest = True

    @property
    def is_open(self) -> bool:
        """Whether the output's stream is open."""
        return self.name is not None

    @property
    def summary(self) -> str:
        """Text for the user about the whole run, usually empty."""
        return ""

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return the seconds from writing to playing a frame, 0 if unknown."""
        return 0.0

    def measure_rate(self) -> MeasuredRate | None:
        """Return the device's measured sample rate, None if unknown. Any thread may call it."""
        return None

    def configure(self, config: RunConfig) -> None:
        """Apply the config's actuators now, and its stream settings to streams opened later."""
        self.set_actuators(config.settings.actuators)

    @abstractmethod
    def locate(self, snapshot: ServerSnapshot | None) -> AudioNode:
        """Return the configured device and no other. NotFoundError: the device is not available."""

    def set_volume(self, connection: PulseConnection | None) -> None:
        """Set the device's volume, if configured. NotFoundError, LostError: it cannot be set."""

    @abstractmethod
    def set_format(self, samplerate: int, channels: int) -> None:
        """Set the rate of the mix in Hz and the vibration's number of channels."""

    @abstractmethod
    def check_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Raise UsageError if the output cannot change to these actuators."""

    @abstractmethod
    def set_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Use actuators that passed `check_actuators`. Close the output if it must be reopened."""

    @abstractmethod
    def maintain(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Open, check or reopen the stream. After LostError or NotFoundError, call it again."""

    def end(self, *, keep: bool) -> None:
        """Close the output for the rest of the run.

        keep: whether to keep an output file. WriteError: writing it failed.
        """
        self.close()


class StreamOutput(Output, Generic[NodeT]):
    """An output with a PortAudio stream on a sink or card."""

    is_card = False
    _identity: "attrgetter[Any]"  # the part of a node that changes if it is plugged in again

    def __init__(
        self, config: RunConfig, pcm: Pcm, states: StateKeeper, priority: AudioPriority | None
    ) -> None:
        super().__init__(config.device)
        self.block_frames = config.live.block_frames
        self.volume = DeviceVolume()
        self.volume.request(config)
        self._pcm, self._priority = pcm, priority
        self._states, self._recording = states, config.recording
        self._router = ChannelRouter(config.settings.actuators)
        self._stream = ReconnectingStream[PlaybackStream](
            "the output", states, Cause.DEVICE_LOST, Cause.DEVICE_MOVED
        )
        self._haptic_channels = 1
        self._found: NodeT | None = None
        self._playing: NodeT | None = None

    @property
    def name(self) -> str | None:
        """Name of the open device, None while closed."""
        return self._playing.name if self._playing and self._stream.stream else None

    @property
    def xruns(self) -> int:
        """See `Endpoint`."""
        return self._stream.xruns

    @property
    def warnings(self) -> list[str]:
        """One warning if the rigs' limit makes the volume lower than the configured volume."""
        return [self.volume.warning] if self.volume.warning else []

    def configure(self, config: RunConfig) -> None:
        """Store the config's block length and volume for later, and apply its actuators."""
        self.block_frames = config.live.block_frames
        self.volume.request(config)
        super().configure(config)

    def retarget(self, config: RunConfig) -> bool:
        """Close the stream and change from sink to sink or from card to card; else return False."""
        if config.device_is_a_card != self.is_card:
            return False
        self.close()
        self.address = config.device
        return True

    def set_format(self, samplerate: int, channels: int) -> None:
        """Set the vibration's number of channels; the device determines the sample rate."""
        self._haptic_channels = channels

    def set_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """See `Output`."""
        channel_map = None
        if self._playing is not None:
            with suppress(UsageError):  # another device will be opened
                channel_map = self._channel_map(self._playing, actuators)
        if not self._router.change(actuators, channel_map):
            self.close()

    def close(self) -> None:
        """Close the stream. Repeated calls do nothing."""
        self._stream.close()

    def set_volume(self, connection: PulseConnection | None) -> None:
        """See `Output`."""
        assert self._found is not None
        self.volume.set(self._volume_setter(self._found, connection))

    @abstractmethod
    def _volume_setter(self, node: NodeT, connection: PulseConnection | None) -> SetVolume:
        """Return a function that sets the device's volume."""

    def maintain(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """See `Output`."""
        stream, node = self._stream, self._found
        assert node is not None
        if stream.stream is not None and self._playing is not None:
            if self._identity(node) != self._identity(self._playing):  # plugged in again
                self.close()
            else:
                stream.check(now_s)
        set_volume = self._volume_setter(node, connection)
        try:
            if stream.stream is not None:
                self.volume.update(set_volume)
            elif place := self._place(node):
                self._pcm.target, sample_format = place
                make = partial(self._playback, node, fill, set_volume, sample_format)
                if stream.open(make, None if self.is_card else connection, node.name, now_s):
                    self._playing = node
                    self._verify(node)
        except CushionError as error:
            if self.is_card or isinstance(error, NotFoundError):  # other errors are the server's
                self.close()
                self._states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            raise

    @abstractmethod
    def _place(self, node: NodeT) -> tuple[Target, SampleFormat] | None:
        """Return the stream's target and sample format; None until the node's setup is known."""

    def _verify(self, node: NodeT) -> None:
        """Raise LostError if the stream was not opened as wanted."""

    @abstractmethod
    def _channel_map(self, node: NodeT, actuators: Sequence[ActuatorSettings]) -> ChannelMap:
        """Return the actuator of each channel. UsageError: the device lacks channels."""

    def _playback(
        self, node: NodeT, fill: Fill, set_volume: SetVolume, sample_format: SampleFormat
    ) -> PlaybackStream:
        self.volume.set(set_volume)
        sent = None
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
    """Sets a device's volume when the device is opened or the config changes.

    wanted_db: volume in dB, 0 or less; None changes nothing. limit_db: highest volume that all
    rigs allow. warning: why the volume is lower than `wanted_db`, or "".
    """

    def __init__(self, wanted_db: float | None = None, limit_db: float = 0.0) -> None:
        self.wanted_db, self.limit_db = wanted_db, limit_db
        self.warning = ""
        self._last: tuple[float | None, float] | None = None, limit_db

    def request(self, config: RunConfig) -> None:
        """Store the config's volume; the next `set` or `update` sets the volume."""
        settings = config.settings
        rigs = {actuator.rig or settings.rig for actuator in settings.actuators} or {settings.rig}
        self.wanted_db = config.live.device_volume_db
        # All channels share one volume, so the lowest limit of all rigs applies.
        self.limit_db = min(rig_by_name(rig).dac.volume_limit_db for rig in rigs)

    def set(self, set_volume: SetVolume) -> None:
        """Set the volume before the device plays. NotFoundError, LostError: it cannot be set."""
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
        """Set the volume if it or its limit has changed since the last `set`. Errors: see `set`."""
        if (self.wanted_db, self.limit_db) != self._last:
            self.set(set_volume)

"""Plays vibration on one sink of the sound server."""

import shlex
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from operator import attrgetter

from audioflinger_hook.daemon.outputs.base import SetVolume, StreamOutput
from device.alsa import find_playback
from device.alsa.offers import MeasuredRate, measure_rate
from device.drive import ActuatorSettings, ChannelMap
from device.drive.channel_positions import sink_channel_map
from device.errors import NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.server.identity import identity_of
from device.server.snapshot import Sink, output_latency_s
from device.stream.pcms import ServerDevice, Target
from device.stream.sample_format import SampleFormat
from device.usb import find_devices
from device.usb.mapping import device_of_sink, hw_names


def muted(name: str) -> str:
    """Return the warning that a sink is muted."""
    return (
        f"{name} is muted, so no vibration comes out; unmute it in the sound settings, or with "
        f"`pactl set-sink-mute {shlex.quote(name)} 0`"
    )


class SinkOutput(StreamOutput[Sink]):
    """A sink of the server as the haptic device."""

    needs_server = True
    _identity = attrgetter("index")  # a new sink may have the old name

    @property
    def warnings(self) -> list[str]:
        """One warning if the rigs limit the volume, and one if the sink is muted."""
        found = self._found
        return super().warnings + ([muted(found.name)] if found and found.mute else [])

    def check_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Raise UsageError if the sink lacks channels for these actuators."""
        if self._found is not None:
            sink_channel_map(self._found, actuators)

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return the server's output latency in seconds, 0 if unknown."""
        if snapshot is None or self._found is None:
            return 0.0
        return output_latency_s(snapshot, self.block_frames, self._found.samplerate)

    def measure_rate(self) -> MeasuredRate | None:
        """Return the measured sample rate of the sink's USB device; see `Output`."""
        sink = self._found
        if sink is None or identity_of(sink).bus != "usb":
            return None
        device = device_of_sink(sink, find_devices().devices)
        for name in hw_names(device) if device else ():
            with suppress(NotFoundError):  # the device was unplugged meanwhile
                if found := measure_rate(find_playback(name.removeprefix("hw:"))):
                    return found
        return None

    def locate(self, snapshot: ServerSnapshot | None) -> Sink:
        """Return the sink. NotFoundError: the sink is missing or lacks channels for actuators."""
        assert snapshot is not None
        found = self.address.sink(snapshot)
        try:
            sink_channel_map(found, self._router.actuators)
        except UsageError as error:
            raise NotFoundError(str(error)) from None
        self._found = found
        return found

    def _place(self, node: Sink) -> tuple[Target, SampleFormat]:
        return ServerDevice(node.name), SampleFormat.FLOAT32

    def _volume_setter(self, node: Sink, connection: PulseConnection | None) -> SetVolume:
        assert connection is not None
        return partial(connection.set_sink_volume_db, node.name)

    def _channel_map(self, node: Sink, actuators: Sequence[ActuatorSettings]) -> ChannelMap:
        return sink_channel_map(node, actuators, self._haptic_channels)

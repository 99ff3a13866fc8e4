"""Channel maps for sinks of a sound server, which assigns channels by their positions."""

from collections.abc import Sequence

from device.drive.channel_map import ChannelMap
from device.drive.settings import ActuatorSettings, wiring_of
from device.errors import UsageError
from device.server.identity import identity_of
from device.server.snapshot import Sink
from device.usb.identity import coil_channels

_POSITIONS = (
    *("front-left", "front-right", "rear-left", "rear-right"),
    *("front-center", "lfe", "side-left", "side-right"),
)

# Positions that the server's ALSA plugin gives to a stream's channels, by channel count. If the
# sink has other positions, the server mixes the channels.
STREAM_POSITIONS = {1: ("mono",)} | {count: _POSITIONS[:count] for count in (2, 4, 5, 6, 8)}


def sink_channel_map(
    sink: Sink, actuators: Sequence[ActuatorSettings], haptic_channels: int = 1
) -> ChannelMap:
    """Return which actuator each channel of a stream to this sink drives.

    haptic_channels: number of channels of the vibration. If `actuators` is empty, the sink's
    channels, or its channels with coils, repeat the vibration's channels. UsageError: the sink
    lacks a channel, or a stream cannot address the sink's channels individually.
    """
    wanted = actuators_of_channels(sink, actuators, haptic_channels)
    repeats = not actuators and None not in wanted.sources
    if repeats or len({*wanted.sources}) == 1:  # such channels need no particular order
        return wanted
    name = f"the sink {sink.name!r}"
    stream = STREAM_POSITIONS.get(sink.channels, ())
    if not stream or sorted(stream) != sorted(sink.positions):
        raise UsageError(
            f"the channels of {name} are {', '.join(sink.positions) or 'without positions'}, which "
            "a stream cannot reach one by one; play to the card itself (--device hw:CARD), give it "
            "a profile with positions, or let one actuator have all channels"
        )
    channels = [sink.positions.index(position) for position in stream]
    return ChannelMap(wanted.actuators, tuple(wanted.sources[channel] for channel in channels))


def actuators_of_channels(
    sink: Sink, actuators: Sequence[ActuatorSettings], haptic_channels: int
) -> ChannelMap:
    """Return which actuator each channel of a sink drives, in the sink's own order.

    If `actuators` is empty and some channels are known to have coils, all others are silent.
    UsageError: the sink lacks a channel.
    """
    name = f"the sink {sink.name!r}"
    if actuators:
        return ChannelMap.of(wiring_of(actuators), sink.channels, sink.positions, name)
    identity = identity_of(sink)
    coils = coil_channels(identity.vendor_id, identity.product_id) if identity.bus == "usb" else ()
    return ChannelMap.on_coils(haptic_channels, sink.channels, coils, name)

"""Channel maps for sinks of a sound server, which matches channels by their positions."""

from __future__ import annotations

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

STREAM_POSITIONS = {1: ("mono",)} | {count: _POSITIONS[:count] for count in (2, 4, 5, 6, 8)}
"""Positions that ALSA's plugin gives to a stream's channels, by channel count. The server matches
these with the sink's positions. If the sink has other positions, the server mixes the channels."""


def sink_channel_map(
    sink: Sink, actuators: Sequence[ActuatorSettings], haptic_channels: int = 1
) -> ChannelMap:
    """Return which actuator each channel of a stream to this sink plays.

    haptic_channels: channels of the vibration; without named actuators they repeat over the sink's.
    UsageError: the sink has no such channel, or a stream cannot reach its channels one by one.
    """
    wanted = actuators_of_channels(sink, actuators, haptic_channels)
    repeats = not actuators and None not in wanted.sources
    if repeats or len({*wanted.sources}) == 1:  # all channels are equal: their order has no effect
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
    """Return which actuator each channel of a sink plays, in the sink's own order.

    Without named actuators, channels of a known device that drive no coils are silent.
    UsageError: the sink has no such channel.
    """
    name = f"the sink {sink.name!r}"
    if actuators:
        return ChannelMap.of(wiring_of(actuators), sink.channels, sink.positions, name)
    identity = identity_of(sink)
    coils = coil_channels(identity.vendor_id, identity.product_id) if identity.bus == "usb" else ()
    return ChannelMap.on_coils(haptic_channels, sink.channels, coils, name)

"""Which channel of a sink each channel of our stream becomes: the server goes by positions."""

from __future__ import annotations

from collections.abc import Sequence

from device.drive import ActuatorSettings, ChannelMap, wiring_of
from device.errors import UsageError
from device.server.snapshot import Sink

_POSITIONS = (
    *("front-left", "front-right", "rear-left", "rear-right"),
    *("front-center", "lfe", "side-left", "side-right"),
)

STREAM_POSITIONS = {1: ("mono",)} | {count: _POSITIONS[:count] for count in (2, 4, 5, 6, 8)}
"""What ALSA's plugin calls the channels of a stream of so many. A sink may have them in another
order; where it has others, the server mixes as it likes."""


def map_on(sink: Sink, actuators: Sequence[ActuatorSettings]) -> ChannelMap:
    """Which actuator each channel of a stream to this sink drives, so that the sink's own do.

    Raises
    ------
    UsageError
        The sink has no such channel, or its channels cannot be reached one by one.
    """
    name = f"the sink {sink.name!r}"
    wanted = ChannelMap.of(wiring_of(actuators), sink.channels, sink.positions, name)
    if len({*wanted.sources}) == 1:  # the same in all of them, whatever becomes what
        return wanted
    stream = STREAM_POSITIONS.get(sink.channels, ())
    if not stream or sorted(stream) != sorted(sink.positions):
        raise UsageError(
            f"the channels of {name} are {', '.join(sink.positions) or 'without positions'}, which "
            "a stream cannot reach one by one; play to the card itself (--device hw:CARD), give it "
            "a profile with positions, or let one actuator have all channels"
        )
    channels = [sink.positions.index(position) for position in stream]
    return ChannelMap(wanted.actuators, tuple(wanted.sources[channel] for channel in channels))

"""The assignment of a device's channels to actuators."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from device.errors import UsageError
from device.units import Float32Array, FloatArray

CHANNELS_MAX = 32  # largest number of channels of a stream

Wiring = tuple[tuple[int | str, ...], ...]  # for each actuator: channel numbers from 0 or positions


@dataclass(frozen=True)
class ChannelMap:
    """The actuator that each channel of a device drives. Any thread may use the map.

    actuators: their number. sources: the actuator of every channel, from 0; None for silence.
    """

    actuators: int
    sources: tuple[int | None, ...]

    @classmethod
    def repeated(cls, actuators: int, channels: int) -> "ChannelMap":
        """Return a map in which consecutive channels drive the actuators in turn."""
        return cls(actuators, tuple(channel % actuators for channel in range(channels)))

    @classmethod
    def on_coils(
        cls, actuators: int, channels: int, coils: Sequence[int], device: str = "the device"
    ) -> "ChannelMap":
        """Return a map in which the channels with coils drive the actuators in turn.

        All other channels are silent. coils: numbers of the channels with coils, from 0; empty if
        all channels have coils. UsageError: the device lacks one of these channels.
        """
        if not coils:
            return cls.repeated(actuators, channels)
        if max(coils) >= channels:
            raise UsageError(
                f"the coils of {device} are on channels {' and '.join(map(str, coils))}, counted "
                f"from 0, but it has {channels} channels: choose its profile with "
                f"{max(coils) + 1}, or name channels in an [[actuator]]"
            )
        sources: list[int | None] = [None] * channels
        for place, channel in enumerate(coils):
            sources[channel] = place % actuators
        return cls(actuators, tuple(sources))

    @classmethod
    def of(
        cls,
        wiring: Sequence[Sequence[int | str]],
        channels: int,
        positions: Sequence[str] = (),
        device: str = "the device",
    ) -> "ChannelMap":
        """Return the map for the channels of each actuator (`wiring`); other channels are silent.

        positions: names of the channels in order, empty if unknown. device: name for messages.
        UsageError: an actuator has no channel, two share a channel, or the device lacks a channel.
        """
        numbered = [
            [_number(channel, channels, positions, device, actuator) for channel in its_channels]
            for actuator, its_channels in enumerate(wiring, 1)
        ]
        for actuator, (wrong, allowed) in check_wiring(numbered).items():
            raise UsageError(f"actuator {actuator} {wrong}; allowed: {allowed}")
        sources: list[int | None] = [None] * channels
        for index, its_numbers in enumerate(numbered):
            for channel in its_numbers:
                sources[channel] = index
        return cls(len(wiring), tuple(sources))

    @property
    def channels(self) -> int:
        """Number of channels of the device."""
        return len(self.sources)

    @cached_property
    def is_identity(self) -> bool:
        """Whether each channel drives the actuator with the same number."""
        return self.sources == tuple(range(self.actuators))

    @cached_property
    def is_direct(self) -> bool:
        """Whether the map is the identity, or all channels drive the only actuator."""
        return self.is_identity or (self.actuators == 1 and set(self.sources) == {0})

    def write(self, vibration: Float32Array | FloatArray, out: Float32Array) -> None:
        """Write vibration, (frames, actuators), into all of `out`, (frames, channels)."""
        for channel, source in enumerate(self.sources):
            out[:, channel] = np.float32(0.0) if source is None else vibration[:, source]

    def mapped(self, vibration: Float32Array | FloatArray) -> Float32Array | FloatArray:
        """Return vibration, (frames, actuators), as (frames, channels); may be the same array."""
        if self.is_identity:
            return vibration
        out = np.empty((len(vibration), self.channels), np.float32)
        self.write(vibration, out)
        return out


def channels_needed(wiring: Sequence[Sequence[int | str]]) -> int:
    """Return how many channels a device needs for a wiring; 1 if it names only positions.

    wiring: channel numbers from 0 or position names of each actuator.
    """
    return 1 + max((c for channels in wiring for c in channels if isinstance(c, int)), default=0)


def check_wiring(wiring: Sequence[Sequence[int | str]]) -> dict[int, tuple[str, str]]:
    """Return errors that a wiring has on any device: {actuator from 1: (error, allowed values)}."""
    found: dict[int, tuple[str, str]] = {}
    taken: dict[int | str, int] = {}
    for actuator, channels in enumerate(wiring, 1):
        if not channels:
            found[actuator] = "has no channel", "one or more"
        for channel in channels:
            if (other := taken.setdefault(channel, actuator)) != actuator:
                found[actuator] = (
                    f"wants channel {channel}, which drives actuator {other}",
                    "every channel for one actuator",
                )
    return found


def _number(
    channel: int | str, channels: int, positions: Sequence[str], device: str, actuator: int
) -> int:
    """Return the channel's number from 0. UsageError: the device lacks the number or position."""
    if isinstance(channel, str):
        if channel in positions:
            return list(positions).index(channel)
        there = f"it has {', '.join(positions)}" if positions else "its channels have numbers only"
    elif 0 <= channel < channels:
        return channel
    else:
        last = f" to {channels - 1}" if channels > 1 else ""
        there = f"it has {channels}, counted from 0: 0{last}"
    raise UsageError(
        f"actuator {actuator} wants channel {channel}, but {device} has no such channel: {there}; "
        "name another channel in its [[actuator]], or a device with more channels"
    )

"""Which actuator each channel of a device drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from device.errors import UsageError
from device.units import Float32Array

CHANNELS_MAX = 32
"""As of every stream."""

Wiring = tuple[tuple[int | str, ...], ...]
"""For every actuator the device's channels: counted from 0, or by position ("front-left")."""


@dataclass(frozen=True)
class ChannelMap:
    """Channels of a device, and whose vibration they get. Any thread.

    actuators: how many there are. sources: for every channel of the device the index of its
    actuator, from 0 on, None for silence.
    """

    actuators: int
    sources: tuple[int | None, ...]

    @classmethod
    def repeated(cls, actuators: int, channels: int) -> ChannelMap:
        """One that leaves no channel silent: actuators repeat where there are more channels."""
        return cls(actuators, tuple(channel % actuators for channel in range(channels)))

    @classmethod
    def of(
        cls,
        wired: Sequence[Sequence[int | str]],
        channels: int,
        positions: Sequence[str] = (),
        device: str = "the device",
    ) -> ChannelMap:
        """One by wiring: wired[k] are the device's channels that drive actuator k.

        positions: what the device calls its channels, in their order; none where it has no names.
        device: its name, for messages, which count actuators from 1 and channels from 0. All
        channels that nobody names stay silent.

        Raises
        ------
        UsageError
            An actuator has no channel, a channel two actuators, or the device has no such channel.
        """
        numbered = [
            [_number(channel, channels, positions, device, actuator) for channel in its_channels]
            for actuator, its_channels in enumerate(wired, 1)
        ]
        for actuator, (wrong, allowed) in wrong_wiring(numbered).items():
            raise UsageError(f"actuator {actuator} {wrong}; allowed: {allowed}")
        sources: list[int | None] = [None] * channels
        for index, its_numbers in enumerate(numbered):
            for channel in its_numbers:
                sources[channel] = index
        return cls(len(wired), tuple(sources))

    @property
    def channels(self) -> int:
        """Channels of the device."""
        return len(self.sources)

    def spread(self, vibration: Float32Array, out: Float32Array) -> None:
        """Write vibration, (frames, actuators), into all of `out`, (frames, channels)."""
        for channel, source in enumerate(self.sources):
            out[:, channel] = np.float32(0.0) if source is None else vibration[:, source]


def channels_needed(wired: Sequence[Sequence[int | str]]) -> int:
    """How many channels a device needs for it at least; 1 for names alone."""
    return 1 + max((c for channels in wired for c in channels if isinstance(c, int)), default=0)


def wrong_wiring(wired: Sequence[Sequence[int | str]]) -> dict[int, tuple[str, str]]:
    """What is wrong with the channels, by the actuator's number from 1: (what, what is allowed).

    Whether a device has such channels is not looked at, nor which number a name means.
    """
    found: dict[int, tuple[str, str]] = {}
    taken: dict[int | str, int] = {}
    for actuator, channels in enumerate(wired, 1):
        if not channels:
            found[actuator] = "has no channel", "one or more"
        for channel in channels:
            other = taken.setdefault(channel, actuator)
            if other != actuator:
                found[actuator] = (
                    f"wants channel {channel}, which drives actuator {other}",
                    "every channel for one actuator",
                )
    return found


def _number(
    channel: int | str, channels: int, positions: Sequence[str], device: str, actuator: int
) -> int:
    """The channel's number, from 0. UsageError: there is none of this number or name."""
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
        f"actuator {actuator} wants channel {channel}, but {device} has none such: {there}; name "
        "another channel in its [[actuator]], or a device with more of them"
    )

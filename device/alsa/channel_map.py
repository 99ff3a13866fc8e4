"""Which actuator each channel of a card drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from device.errors import UsageError
from device.units import Float32Array


@dataclass(frozen=True)
class ChannelMap:
    """Channels of a card, and whose vibration they get. Any thread.

    actuators: how many there are. sources: for every channel of the card the number of its
    actuator, from 0 on, None for silence.
    """

    actuators: int
    sources: tuple[int | None, ...]

    @classmethod
    def repeated(cls, actuators: int, channels: int) -> ChannelMap:
        """One that leaves no channel silent: actuators repeat where there are more channels."""
        return cls(actuators, tuple(channel % actuators for channel in range(channels)))

    @classmethod
    def of(cls, wired: Sequence[Sequence[int]], channels: int) -> ChannelMap:
        """One by wiring: wired[k] are the card's channels, from 0 on, that drive actuator k.

        All other channels stay silent.

        Raises
        ------
        UsageError
            An actuator has no channel, a channel two actuators, or the card has no such channel.
        """
        sources: list[int | None] = [None] * channels
        for actuator, its_channels in enumerate(wired):
            if not its_channels:
                raise UsageError(f"actuator {actuator} has no channel; name one at least")
            for channel in its_channels:
                if not 0 <= channel < channels:
                    raise UsageError(
                        f"actuator {actuator}: there is no channel {channel}; the card has "
                        f"{channels}, counted from 0"
                    )
                if sources[channel] is not None:
                    raise UsageError(
                        f"channel {channel} cannot drive actuators {sources[channel]} and "
                        f"{actuator} at once; name another one"
                    )
                sources[channel] = actuator
        return cls(len(wired), tuple(sources))

    @property
    def channels(self) -> int:
        """Channels of the card."""
        return len(self.sources)

    def spread(self, vibration: Float32Array, out: Float32Array) -> None:
        """Write vibration, (frames, actuators), into all of `out`, (frames, channels)."""
        for channel, source in enumerate(self.sources):
            out[:, channel] = np.float32(0.0) if source is None else vibration[:, source]

"""Copies the signal of each actuator to its channels of a device."""

from collections.abc import Callable, Sequence

import numpy as np

from device.drive.channel_map import ChannelMap
from device.drive.settings import ActuatorSettings
from device.errors import InternalError
from device.units import Float32Array

Fill = Callable[[Float32Array, float], None]  # (out, now_s): writes (frames, actuators) into out


class ChannelRouter:
    """Connects actuators with each stream that an output opens. Only one thread may use it."""

    def __init__(self, actuators: Sequence[ActuatorSettings]) -> None:
        self.actuators = actuators
        self._routed: RoutedFill | None = None

    def connect(self, fill: Fill, channel_map: ChannelMap, block_frames: int) -> Fill:
        """Return the function that fills the device's channels, for a stream that opens now."""
        self._routed = RoutedFill(fill, channel_map, block_frames)
        return self._routed.fill

    def change(self, actuators: Sequence[ActuatorSettings], channel_map: ChannelMap | None) -> bool:
        """Change the actuators; return whether the open stream can continue with the new map."""
        before, self.actuators = self.actuators, actuators
        if before == actuators:
            return True
        routed = self._routed
        if not (routed and channel_map) or len(before) != len(actuators):
            return False
        if routed.channels != channel_map.channels:
            return False
        routed.change(channel_map)
        return True


class RoutedFill:
    """Fills a device's channels from a `Fill` function, which fills one column for each actuator.

    The output's thread calls `fill`, which allocates memory only for blocks of an unusual length.
    Any thread may call `change`.
    """

    def __init__(self, fill: Fill, channel_map: ChannelMap, block_frames: int) -> None:
        self._fill = fill
        self._map = self._wanted = channel_map
        self._take_memory(block_frames)

    @property
    def channels(self) -> int:
        """Number of channels of the device."""
        return self._wanted.channels

    def change(self, channel_map: ChannelMap) -> None:
        """Change to another map, with a cross-fade over the next block.

        InternalError: the maps differ in their number of actuators or channels.
        """
        old = self._wanted
        if (old.actuators, old.channels) != (channel_map.actuators, channel_map.channels):
            raise InternalError(
                f"{channel_map.actuators} actuators on {channel_map.channels} channels cannot "
                f"replace {old.actuators} on {old.channels}"
            )
        self._wanted = channel_map

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next block of vibration into `out`, (frames, channels)."""
        old, new = self._map, self._wanted
        if new is old and new.is_direct:
            self._fill(out[:, : new.actuators], now_s)
            out[:, new.actuators :] = out[:, :1]
            return
        if len(self._vibration) != len(out):
            self._take_memory(len(out))
        else:
            self._vibration[:] = np.float32(0.0)
        self._fill(self._vibration, now_s)
        new.write(self._vibration, out)
        if new is not old:
            old.write(self._vibration, self._old)
            out += self._leaving * (self._old - out)
            self._map = new

    def _take_memory(self, frames: int) -> None:
        self._vibration = np.zeros((frames, self._map.actuators), np.float32)
        self._old = np.zeros((frames, self._map.channels), np.float32)
        self._leaving = np.linspace(1.0, 0.0, frames + 1, dtype=np.float32)[1:, None]

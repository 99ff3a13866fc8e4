"""Actuators on a device's channels in the live path: another wiring fades in over one block."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from device.drive.channel_map import ChannelMap
from device.errors import InternalError
from device.units import Float32Array

Fill = Callable[[Float32Array, float], None]
"""(out, now_s): writes what is played next, (frames, actuators)."""


class Spread:
    """What fills a device's channels from what fills one for each actuator.

    fill: called with zeros of (frames, actuators). block_frames: the usual length of a block;
    another one takes new memory. The output's thread calls `fill`; any thread may call `change`.
    """

    def __init__(self, fill: Fill, channel_map: ChannelMap, block_frames: int) -> None:
        self._fill = fill
        self._map = self._wanted = channel_map
        self._take_memory(block_frames)

    @property
    def channels(self) -> int:
        """Channels of the device."""
        return self._wanted.channels

    def change(self, channel_map: ChannelMap) -> None:
        """Go over to another map of as many actuators and channels, within the next block."""
        old = self._wanted
        if (old.actuators, old.channels) != (channel_map.actuators, channel_map.channels):
            raise InternalError(
                f"{channel_map.actuators} actuators on {channel_map.channels} channels cannot "
                f"follow {old.actuators} on {old.channels}"
            )
        self._wanted = channel_map

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write what is played next, (frames, channels)."""
        if len(self._vibration) != len(out):
            self._take_memory(len(out))
        else:
            self._vibration[:] = np.float32(0.0)
        self._fill(self._vibration, now_s)
        old, new = self._map, self._wanted
        new.spread(self._vibration, out)
        if new is not old:
            old.spread(self._vibration, self._old)
            out += self._leaving * (self._old - out)
            self._map = new

    def _take_memory(self, frames: int) -> None:
        self._vibration = np.zeros((frames, self._map.actuators), np.float32)
        self._old = np.zeros((frames, self._map.channels), np.float32)
        self._leaving = np.linspace(1.0, 0.0, frames + 1, dtype=np.float32)[1:, None]

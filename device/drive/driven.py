"""Actuators in front of an output that is no live one, such as a file."""

from __future__ import annotations

import numpy as np

from device.drive.actuators import Actuators
from device.drive.channel_map import ChannelMap
from device.errors import InternalError
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray


class Driven:
    """A `VibrationOutput` of the sources' vibration that passes the actuators' to an output.

    output: has the channels of `channel_map`. What the actuators hold for their rigs comes out
    when it is closed, `latency_frames` late in all, which `Aligned` behind it takes out; what a
    `delay_ms` carries past the end does not, so that it is as long as what was written.

    Called by the thread that delivers the vibration.
    """

    def __init__(
        self, output: VibrationOutput, actuators: Actuators, channel_map: ChannelMap
    ) -> None:
        if output.channels != channel_map.channels:
            raise InternalError(
                f"the output has {output.channels} channels, the map {channel_map.channels}"
            )
        self._output = output
        self._actuators = actuators
        self._map = channel_map
        self._closed = False

    @property
    def samplerate(self) -> int:
        """Rate of the output in Hz."""
        return self._output.samplerate

    @property
    def channels(self) -> int:
        """How many sources there are."""
        return len(self._actuators.sources)

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block, (frames, sources)."""
        if self._closed:
            raise InternalError("the output is closed: nothing can be written to it")
        driven = self._actuators.process(vibration)
        out = np.empty((len(driven), self._map.channels), np.float32)
        self._map.spread(driven, out)
        self._output.write(out)

    def close(self) -> None:
        """Pass on what the rigs' processing still holds, and finish the output."""
        if not self._closed:
            self.write(np.zeros((self._actuators.latency_frames, self.channels), np.float32))
            self._closed = True
        self._output.close()

    def abort(self) -> None:
        """Discard the output."""
        self._closed = True
        self._output.abort()

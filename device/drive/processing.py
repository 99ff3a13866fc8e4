"""What stands between the vibration and its output: block processors, and an output behind them."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from device.errors import InternalError
from device.output import VibrationOutput
from device.units import Block, Float32Array, FloatArray


class BlockProcessor(Protocol):
    """Changes vibration block by block, or only looks at it; holds its state.

    `Damper`, `Protector` and `ExposureMeter` are such. One thread calls it; it neither waits,
    logs nor allocates without bound, and what leaves is finite.
    """

    @property
    def latency_frames(self) -> int:
        """By how many frames the vibration comes later."""
        ...

    def reset(self) -> None:
        """Begin anew, at rest."""
        ...

    def process(self, block: Block) -> Block:
        """Treat a block of (frames, channels) in place, any number of frames, and return it."""
        ...


class Processed:
    """A `VibrationOutput` that passes every block through processors, then on to `output`.

    processors: in their order, made for the rate and the channels of the output. Their delay
    stays in what is passed on, as that of the effect does: `latency_frames` in all, which `Aligned`
    takes out where there is time to do so. Closing passes on what they still hold.

    Called by the thread that delivers the vibration.
    """

    def __init__(self, output: VibrationOutput, processors: Sequence[BlockProcessor]) -> None:
        self._output = output
        self._processors = tuple(processors)
        self._closed = False

    @property
    def samplerate(self) -> int:
        """Rate of the output in Hz."""
        return self._output.samplerate

    @property
    def channels(self) -> int:
        """Channels of the output."""
        return self._output.channels

    @property
    def latency_frames(self) -> int:
        """Delay of all processors together, frames."""
        return sum(processor.latency_frames for processor in self._processors)

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block, (frames, channels), which is not changed."""
        if self._closed:
            raise InternalError("the output is closed: nothing can be written to it")
        block: FloatArray = vibration.astype(np.float64)  # a copy, and exact
        for processor in self._processors:
            processor.process(block)
        self._output.write(block)

    def close(self) -> None:
        """Pass on what is still on its way, and finish the output."""
        if not self._closed:
            self.write(np.zeros((self.latency_frames, self.channels)))
            self._closed = True
        self._output.close()

    def abort(self) -> None:
        """Discard the output."""
        self._closed = True
        self._output.abort()

"""Outputs in front of another output: without the latency, or with a drive's processing."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from device.drive.channel_map import ChannelMap
from device.errors import InternalError
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray


class Driver(Protocol):
    """What an output can have in front of it; `Drive` is one."""

    @property
    def inputs(self) -> int:
        """Columns of a block that comes."""
        ...

    @property
    def latency_frames(self) -> int:
        """Delay of the vibration in frames."""
        ...

    def process(self, vibration: FloatArray) -> FloatArray | Float32Array:
        """Return the driven vibration for a block, which does not change."""
        ...


class AlignedOutput:
    """An output without the first `latency_frames`, so that vibration starts with its sound.

    Meant for files; a device that plays takes the delay line instead. The thread that delivers
    the vibration calls it.

    output: gets all later frames.
    latency_frames: number of frames to drop.
    peak: largest magnitude so far, of full scale.
    """

    def __init__(self, output: VibrationOutput, latency_frames: int) -> None:
        self._output = output
        self._to_skip = latency_frames
        self.samplerate = output.samplerate
        self.channels = output.channels
        self.peak = 0.0

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels)."""
        skipped = min(self._to_skip, len(vibration))
        self._to_skip -= skipped
        if skipped < len(vibration):
            passed = vibration[skipped:]
            self.peak = max(self.peak, float(np.abs(passed).max()))
            self._output.write(passed)

    def close(self) -> None:
        """Finish the output."""
        self._output.close()

    def abort(self) -> None:
        """Discard the output."""
        self._output.abort()


class DrivenOutput:
    """An output behind a drive, for outputs that are not live.

    The drive's latency stays in the vibration. Closing first writes what the rigs' processing
    still holds, but not what a `delay_ms` carries past the end. The thread that delivers the
    vibration calls it.

    output: gets what the device's channels play.
    drive: processes the vibration.
    channel_map: which of the drive's columns each channel of the output plays.
    """

    def __init__(self, output: VibrationOutput, drive: Driver, channel_map: ChannelMap) -> None:
        if output.channels != channel_map.channels:
            raise InternalError(
                f"the output has {output.channels} channels, the channel map {channel_map.channels}"
            )
        self._output = output
        self._drive = drive
        self._map = channel_map
        self._closed = False
        self.samplerate = output.samplerate
        self.channels = drive.inputs

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels), which does not change."""
        if self._closed:
            raise InternalError("the output is closed: nothing can be written to it")
        # In double precision, so that nothing is rounded between the stages.
        driven = self._drive.process(vibration.astype(np.float64))
        self._output.write(self._map.mapped(driven))

    def close(self) -> None:
        """Write what is still held back, and finish the output."""
        if not self._closed:
            self.write(np.zeros((self._drive.latency_frames, self.channels)))
            self._closed = True
        self._output.close()

    def abort(self) -> None:
        """Discard the output."""
        self._closed = True
        self._output.abort()

"""Outputs that wrap another output, to remove latency, process the vibration, or fade its end."""

from typing import Protocol

import numpy as np

from device.drive.channel_map import ChannelMap
from device.errors import InternalError
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray

FADE_S = 0.005  # length of the fade at the end of a file, which prevents a click


class Driver(Protocol):
    """Processes the vibration before an output. `Drive` implements this interface."""

    inputs: int  # channels of an input block
    latency_frames: int  # delay of the vibration

    def process(self, vibration: FloatArray) -> FloatArray | Float32Array:
        """Return the processed vibration of a block; the block does not change."""
        ...


class WrappedOutput:
    """Passes blocks to another output of the same sample rate and number of channels."""

    def __init__(self, output: VibrationOutput) -> None:
        self._output = output
        self.samplerate, self.channels = output.samplerate, output.channels

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels); the block does not change."""
        self._output.write(vibration)

    def close(self) -> None:
        """Finish the output. May be repeated."""
        self._output.close()

    def abort(self) -> None:
        """Discard the output."""
        self._output.abort()


class AlignedOutput(WrappedOutput):
    """Drops the first latency_frames frames, so that vibration starts together with its sound."""

    def __init__(self, output: VibrationOutput, latency_frames: int) -> None:
        super().__init__(output)
        self._to_skip = latency_frames

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels)."""
        skipped = min(self._to_skip, len(vibration))
        self._to_skip -= skipped
        if skipped < len(vibration):
            super().write(vibration[skipped:])


class DrivenOutput(WrappedOutput):
    """Processes vibration with a `Driver` before another output; the driver's latency remains.

    `close` first writes the frames that the `Driver` has delayed. If an actuator's `delay_ms` moves
    a part of the signal beyond the end of the output, this part is lost.
    """

    def __init__(self, output: VibrationOutput, drive: Driver, channel_map: ChannelMap) -> None:
        if output.channels != channel_map.channels:
            raise InternalError(
                f"the output has {output.channels} channels, the channel map {channel_map.channels}"
            )
        super().__init__(output)
        self._drive, self._map, self._closed = drive, channel_map, False
        self.channels = drive.inputs

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels); the block does not change."""
        if self._closed:
            raise InternalError("the output is closed: nothing can be written to it")
        # Double precision keeps the rounding between the stages negligible.
        super().write(self._map.mapped(self._drive.process(vibration.astype(np.float64))))

    def close(self) -> None:
        """Write the delayed frames, and finish the output. May be repeated."""
        if not self._closed:
            self.write(np.zeros((self._drive.latency_frames, self.channels)))
            self._closed = True
        super().close()

    def abort(self) -> None:
        """Discard the output."""
        self._closed = True
        super().abort()


class FadedOutput(WrappedOutput):
    """Fades out the last `frames` frames with a raised cosine. peak: largest magnitude written."""

    def __init__(self, output: VibrationOutput, frames: int) -> None:
        super().__init__(output)
        self._frames = frames
        self._held = np.zeros((0, output.channels))
        self.peak = 0.0

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels)."""
        known: FloatArray = np.concatenate((self._held, vibration))
        passed = max(0, len(known) - self._frames)
        self._held = known[passed:]
        self._pass_on(known[:passed])

    def close(self) -> None:
        """Fade and write the last frames, and finish the output. May be repeated."""
        held, self._held = self._held, self._held[:0]
        shares = (np.arange(len(held)) + 0.5) / max(1, len(held))
        self._pass_on(held * (0.5 + 0.5 * np.cos(np.pi * shares))[:, None])
        super().close()

    def abort(self) -> None:
        """Discard the output."""
        self._held = self._held[:0]
        super().abort()

    def _pass_on(self, vibration: FloatArray) -> None:
        if len(vibration):
            self.peak = max(self.peak, float(np.abs(vibration).max()))
            super().write(vibration)

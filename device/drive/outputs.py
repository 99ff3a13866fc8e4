"""Outputs that wrap another output: they remove the latency, apply a drive, or fade the end."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from device.drive.channel_map import ChannelMap
from device.errors import InternalError
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray

FADE_S = 0.005  # at the end of a file, so that a tone that lasts to it stops without a click


class Driver(Protocol):
    """Processing before an output, such as `Drive`."""

    inputs: int  # columns of an input block
    latency_frames: int  # delay of the vibration

    def process(self, vibration: FloatArray) -> FloatArray | Float32Array:
        """Return the driven vibration for a block; the block does not change."""
        ...


class WrappedOutput:
    """An output in front of another one, of the same rate and channels. One thread calls it."""

    def __init__(self, output: VibrationOutput) -> None:
        self._output = output
        self.samplerate = output.samplerate
        self.channels = output.channels

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels); the block does not change."""
        self._output.write(vibration)

    def close(self) -> None:
        """Write the frames still held back, and finish the output. May be repeated."""
        self._output.close()

    def abort(self) -> None:
        """Discard the output."""
        self._output.abort()


class AlignedOutput(WrappedOutput):
    """Drops the first `latency_frames`, so that vibration in a file starts with its sound."""

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
    """Applies a drive before an output that is not live; its latency stays in the vibration.

    `close` first writes the frames that the rigs' processing still holds, but no frames that a
    `delay_ms` moves past the end.
    """

    def __init__(self, output: VibrationOutput, drive: Driver, channel_map: ChannelMap) -> None:
        if output.channels != channel_map.channels:
            raise InternalError(
                f"the output has {output.channels} channels, the channel map {channel_map.channels}"
            )
        super().__init__(output)
        self._drive = drive
        self._map = channel_map
        self._closed = False
        self.channels = drive.inputs

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels); the block does not change."""
        if self._closed:
            raise InternalError("the output is closed: nothing can be written to it")
        # In double precision, to avoid rounding between the stages.
        driven = self._drive.process(vibration.astype(np.float64))
        super().write(self._map.mapped(driven))

    def close(self) -> None:
        """Write the frames still held back, and finish the output. May be repeated."""
        if not self._closed:
            self.write(np.zeros((self._drive.latency_frames, self.channels)))
            self._closed = True
        super().close()

    def abort(self) -> None:
        """Discard the output."""
        self._closed = True
        super().abort()


class FadedOutput(WrappedOutput):
    """Fades the last frames before it closes an output, by a raised cosine.

    For files whose end cuts the sound off. A shorter file is faded from its first frame on.
    frames: length of the fade, 0 for none. peak: largest magnitude written so far.
    """

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
        """Write the frames held back, faded, and finish the output. May be repeated."""
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

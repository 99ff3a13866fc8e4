"""Vibration laid back under the sound that caused it, where there is time to do so."""

from __future__ import annotations

import numpy as np

from device.output import VibrationOutput
from device.units import Float32Array, FloatArray


class Aligned:
    """An output without the first `latency_frames`: what remains begins with the sound.

    For files, which know no delay; something that plays takes the delay line instead. Passes
    everything else on to `output`. Called by the thread that delivers the vibration.

    peak: largest magnitude that was passed on so far.
    """

    def __init__(self, output: VibrationOutput, latency_frames: int) -> None:
        self._output = output
        self._to_skip = latency_frames
        self.peak = 0.0

    @property
    def samplerate(self) -> int:
        """Rate of the output in Hz."""
        return self._output.samplerate

    @property
    def channels(self) -> int:
        """Channels of the output."""
        return self._output.channels

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block, (frames, channels), and pass on what lies after the latency."""
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

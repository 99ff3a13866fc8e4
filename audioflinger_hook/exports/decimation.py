"""Vibration at another rate, aligned with the original, and its energy above 250 Hz."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import ellip, sosfilt

from audioflinger_hook.mixer.resampler import Resampler, frames_out
from device.drive.outputs import WrappedOutput
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray, amplitude_to_db, check_channels

AUDIBLE_FROM_HZ = 250.0
PIECE_FRAMES = 8_192  # fed to the resampler at once, so that its memory is bounded


class ResampledOutput(WrappedOutput):
    """Converts the rate before an output by a linear-phase low-pass, without any delay.

    The filter is that of `Resampler`. n frames become ceil(n rate_out / rate_in). The delivering
    thread calls it.

    samplerate: rate in Hz of the frames that come.
    """

    def __init__(self, output: VibrationOutput, samplerate: int) -> None:
        super().__init__(output)
        self.samplerate = samplerate
        common = int(np.gcd(samplerate, output.samplerate))
        self._up, self._down = output.samplerate // common, samplerate // common
        most = frames_out(PIECE_FRAMES, samplerate, output.samplerate) + 1
        self._resampler = Resampler(samplerate, output.samplerate, self.channels, most)
        # Silence before the sound, so that the filter's delay is a whole number of output frames.
        silence = -self._resampler.latency_frames % self._down
        self._resampler.feed(np.zeros((silence, self.channels), np.float32))
        self._fed = silence
        self._to_skip = (silence + self._resampler.latency_frames) * self._up // self._down
        self._made = self._taken = 0

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels)."""
        self._taken += len(vibration)
        self._feed(vibration)

    def close(self) -> None:
        """Write the frames that the filter still holds, and finish the output."""
        wanted = self._to_skip + frames_out(self._taken, self._down, self._up)
        while self._made < wanted:
            self._feed(np.zeros((PIECE_FRAMES, self.channels), np.float32), wanted)
        super().close()

    def _feed(self, vibration: FloatArray | Float32Array, wanted: int | None = None) -> None:
        for first in range(0, len(vibration), PIECE_FRAMES):
            piece = vibration[first : first + PIECE_FRAMES].astype(np.float32)
            self._resampler.feed(piece)
            self._fed += len(piece)
            ready = frames_out(self._fed, self._down, self._up)
            due = (ready if wanted is None else min(ready, wanted)) - self._made
            frames = np.empty((due, self.channels), np.float32)
            self._resampler.produce(frames)
            skipped = min(due, max(0, self._to_skip - self._made))
            self._made += due
            self._output.write(frames[skipped:])


Watch = Callable[[FloatArray | Float32Array, int], None]
"""Called with each block of vibration, (frames, channels), before its conversion, and its rate."""


class LeakMeter(WrappedOutput):
    """Passes vibration to an output and measures its energy above 250 Hz. Use from one thread.

    An elliptic high-pass of order 12 separates it: 0.1 dB of ripple above 250 Hz, 80 dB of
    attenuation below 230 Hz.
    """

    def __init__(self, output: VibrationOutput, watch: Watch | None = None) -> None:
        super().__init__(output)
        self._watch = watch
        self._high_pass = ellip(
            12, 0.1, 80.0, AUDIBLE_FROM_HZ, "high", fs=self.samplerate, output="sos"
        )
        self._state = np.zeros((len(self._high_pass), 2, self.channels))
        self._energy = self._above = 0.0

    @property
    def leak_db(self) -> float | None:
        """Energy above 250 Hz in dB of all; None for silence."""
        if not self._energy or not self._above:
            return None
        return amplitude_to_db(float(np.sqrt(self._above / self._energy)))

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block, (frames, channels)."""
        check_channels(vibration, self.channels)
        if len(vibration):
            exact = vibration.astype(np.float64)
            above, self._state = sosfilt(self._high_pass, exact, axis=0, zi=self._state)
            # Not by BLAS: its threads would cost more time than the rendering.
            self._energy += float(np.square(exact).sum())
            self._above += float(np.square(above).sum())
            if self._watch:
                self._watch(vibration, self.samplerate)
        super().write(vibration)

"""Damping in the live path: a section and, for a shaper, a few taps."""

import numpy as np
from scipy.signal import sosfilt

from device.drive.damping.design import Damping
from device.errors import InternalError, UsageError
from device.units import Block, Float32Array, FloatArray, check_channels, finite_or_zero

_ABSURD = 1e30
_SILENT = 1e-30
_REST_S = 0.05
"""A state that has decayed is set to 0 at multiples of this, so that it never gets as small as
slow, denormal numbers: even a pair at 500 Hz with Q 0.3 falls by no more than 1e-114 in between."""


class Damper:
    """Damps one stream of vibration; holds its state. One thread calls it.

    samplerate: Hz; channels: 1 or more, which all get the same damping (actuators that differ get
    a damper each, on their columns). Its delay is `damping.latency_s`.

    replaced_samples: those that were not finite, or absurd, and were taken as 0, so far.

    Raises
    ------
    UsageError
        The samplerate is too low for the damping.
    """

    def __init__(self, damping: Damping, samplerate: float, channels: int) -> None:
        if not (np.isfinite(samplerate) and samplerate > 0):
            raise UsageError(f"samplerate={samplerate!r} Hz must be above 0; choose another rate")
        if channels < 1:
            raise InternalError(f"channels={channels} must be 1 or more")
        self.damping = damping
        self.samplerate = samplerate
        self.channels = channels
        self._sections = damping.sections(samplerate)
        taps = damping.taps(samplerate)
        self._delays = np.flatnonzero(taps)
        self._amplitudes = taps[self._delays] * damping.gain
        self._part_frames = max(1, round(_REST_S * samplerate))
        self.reset()

    @property
    def latency_frames(self) -> int:
        """By how many frames the vibration comes later: those of the damping's latency."""
        return round(self.damping.latency_s * self.samplerate)

    def reset(self) -> None:
        """Forget everything; the count is 0."""
        self.replaced_samples = 0
        self._state = np.zeros((len(self._sections), 2, self.channels))
        self._past = np.zeros((int(self._delays[-1]), self.channels))
        self._frames_to_check = self._part_frames

    def process(self, block: Block) -> Block:
        """Damp a block of (frames, channels) in place, any number of frames; return it.

        The state is float64, and no byte depends on how the stream is cut into blocks. What comes
        out is finite.
        """
        check_channels(block, self.channels)
        start = 0
        while start < len(block):
            stop = min(start + self._frames_to_check, len(block))
            block[start:stop] = self._filtered(block[start:stop])
            start = stop
        return block

    def _filtered(self, block: FloatArray | Float32Array) -> FloatArray:
        """A part of a block, which ends at most where the state is to be looked at."""
        samples, replaced = finite_or_zero(block.astype(np.float64), _ABSURD)
        self.replaced_samples += replaced
        samples = self._shaped(samples)
        if len(self._sections):
            samples, self._state = sosfilt(self._sections, samples, axis=0, zi=self._state)
        self._frames_to_check -= len(block)
        if self._frames_to_check == 0:
            self._frames_to_check = self._part_frames
            if np.abs(self._state).max(initial=0.0) < _SILENT:
                self._state[:] = 0.0
        return samples

    def _shaped(self, samples: FloatArray) -> FloatArray:
        """The sum of the delayed copies, always added in the same order."""
        longest = len(self._past)
        if longest:
            samples = np.concatenate([self._past, samples])
            self._past = samples[-longest:].copy()
        frames = len(samples) - longest
        shaped: FloatArray = np.zeros((frames, self.channels))
        for delay, amplitude in zip(self._delays, self._amplitudes, strict=True):
            first = longest - delay
            shaped += amplitude * samples[first : first + frames]
        return shaped

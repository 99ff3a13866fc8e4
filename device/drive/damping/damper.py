"""Damping in the live path: a second-order section."""

import numpy as np
from scipy.signal import sosfilt

from device.drive.damping.design import Damping
from device.units import Block, Float32Array, FloatArray, check_channels, finite_or_zero

_ABSURD = 1e30
_SILENT = 1e-30
_REST_S = 0.05
"""A decayed state is set to 0 at multiples of this time, before it becomes denormal and slow. In
between, even a pair at 500 Hz with Q 0.3 falls by at most 1e-114."""


class Damper:
    """Damps one stream of vibration, without delay. One thread calls it.

    Parameters
    ----------
    damping : Damping
        The filter.
    samplerate : float
        Rate in Hz.
    channels : int
        Number of channels, all with the same filter.

    Attributes
    ----------
    replaced_samples : int
        Samples so far that were not finite or beyond 1e30, and were replaced by 0.

    Raises
    ------
    UsageError
        The sample rate is too low for the filter.
    """

    def __init__(self, damping: Damping, samplerate: float, channels: int) -> None:
        self.damping = damping
        self.channels = channels
        self._sections = damping.sections(samplerate)
        self._part_frames = max(1, round(_REST_S * samplerate))
        self.reset()

    def reset(self) -> None:
        """Return to rest; the count becomes 0."""
        self.replaced_samples = 0
        self._state = np.zeros((len(self._sections), 2, self.channels))
        self._frames_to_check = self._part_frames

    def process(self, block: Block) -> Block:
        """Damp a block, (frames, channels), in place and return it.

        The output is finite and does not depend on the lengths of blocks.
        """
        check_channels(block, self.channels)
        start = 0
        while start < len(block):
            stop = min(start + self._frames_to_check, len(block))
            block[start:stop] = self._filtered(block[start:stop])
            start = stop
        return block

    def _filtered(self, block: FloatArray | Float32Array) -> FloatArray:
        """Filter and return a part of a block; the part ends at or before a check of the state."""
        samples, replaced = finite_or_zero(block.astype(np.float64), _ABSURD)
        self.replaced_samples += replaced
        samples = 0.0 + self.damping.gain * samples  # no sample is -0.0
        if len(self._sections):
            samples, self._state = sosfilt(self._sections, samples, axis=0, zi=self._state)
        self._frames_to_check -= len(block)
        if self._frames_to_check == 0:
            self._frames_to_check = self._part_frames
            if np.abs(self._state).max(initial=0.0) < _SILENT:
                self._state[:] = 0.0
        return samples

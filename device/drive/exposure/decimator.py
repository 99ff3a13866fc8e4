"""Fewer samples of the same vibration: a low-pass and every n-th frame, in fixed parts."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import firwin

from device.units import FloatArray

_LENGTHS = 6
_KAISER_BETA = 8.0
"""80 dB down at the frequencies that would fold onto the vibration."""


class Decimator:
    """Takes every `factor`-th frame of a stream that is low-passed before; holds its state.

    factor: 1 or more; 1 leaves the stream as it is. channels: 1 or more.

    Below a twentieth of the new rate it changes nothing by more than 1e-3; what folds onto
    that band is 80 dB down. One thread calls it.
    """

    def __init__(self, factor: int, channels: int) -> None:
        self.factor = factor
        self._channels = channels
        taps = _LENGTHS * factor + 1
        # A corner of half the new rate: transition may be wide, only the low end is wanted.
        self._taps = (
            firwin(taps, 1.0 / factor, window=("kaiser", _KAISER_BETA))
            if factor > 1
            else np.ones(1)
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._past = np.zeros((len(self._taps) - 1, self._channels))

    def process(self, frames: FloatArray) -> FloatArray:
        """(n, channels) of (n * factor, channels)."""
        if self.factor == 1:
            return frames
        longer = np.concatenate([self._past, frames])
        self._past = longer[len(frames) :].copy()
        windows = sliding_window_view(longer, len(self._taps), axis=0)
        decimated: FloatArray = windows[self.factor - 1 :: self.factor] @ self._taps
        return decimated

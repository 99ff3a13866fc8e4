"""The band-pass ahead of the analysis: the paper's 50 Hz to 12 kHz, second-order Butterworth."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, lfilter

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.intake import DENORMAL_GUARD
from audioflinger_hook.transform.parameters import TransformParameters
from device.errors import UsageError

NYQUIST_MARGIN = 0.49
"""A band edge from this fraction of the samplerate up cannot be filtered; the low edge alone is."""


class BandPass:
    """The band-passed stream, continued from block to block; any split gives the same bytes.

    One direct-form recursion: its rounding stays under 1e-10 of full scale up to 96 kHz (2e-9 at
    192 kHz, 1e-6 at 768 kHz), and one call a hop costs a quarter of second-order sections.
    """

    def __init__(self, parameters: TransformParameters, samplerate: int) -> None:
        low, high = parameters.band_low_hz, parameters.band_high_hz
        if low >= NYQUIST_MARGIN * samplerate:
            raise UsageError(
                f"band_low_hz={low:g} cannot be filtered at samplerate={samplerate} Hz; "
                f"allowed: under {NYQUIST_MARGIN * samplerate:g} Hz"
            )
        if high >= NYQUIST_MARGIN * samplerate:
            self._b, self._a = butter(2, low, "highpass", fs=samplerate)
        else:
            self._b, self._a = butter(2, (low, high), "bandpass", fs=samplerate)
        self._guard = DENORMAL_GUARD
        self.reset()

    def reset(self) -> None:
        """Return to the zero state of a new stream."""
        self._state = np.zeros(self._a.size - 1)

    @property
    def past(self) -> bytes:
        """All that what was heard does to what comes; may be set, of the same samplerate."""
        return self._state.tobytes()

    @past.setter
    def past(self, past: bytes) -> None:
        self._state = np.frombuffer(past).copy()

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the filtered block, (frames,) float64. Called on the audio thread."""
        if not mono.size:
            return mono
        filtered, self._state = lfilter(self._b, self._a, mono + self._guard, zi=self._state)
        return np.asarray(filtered)

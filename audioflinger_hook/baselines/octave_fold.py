"""Two sines: the strongest spectral peak of each of two ranges, lowered by octaves.

The ranges are 400 to 1000 Hz and 1000 to 3600 Hz.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.baselines.hops import SineBaseline
from audioflinger_hook.transform import FloatArray

RANGES_HZ = ((400.0, 1_000.0), (1_000.0, 3_600.0))
UNDER_HZ = 230.0
OVERLAP = 4
WEAKEST = 1e-4  # weaker peaks are rounding errors or hiss, and give no vibration


class Method(SineBaseline):
    """Halves the frequency of each peak until it is below 230 Hz, and keeps the amplitude."""

    def __init__(self, samplerate: int, channels: int) -> None:
        super().__init__(samplerate, channels, voices=len(RANGES_HZ), overlap=OVERLAP)
        self._ranges = [
            np.flatnonzero((self.bins_hz >= low_hz) & (self.bins_hz < high_hz))
            for low_hz, high_hz in RANGES_HZ
        ]

    def lead(self, amplitude: FloatArray, newest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return frequency and amplitude of both sines; a range without a peak has amplitude 0."""
        hz, level = np.full((2, len(amplitude), len(self._ranges)), UNDER_HZ)
        level[:] = 0.0
        rows = np.arange(len(amplitude))
        for voice, bins in enumerate(self._ranges):
            bins = bins[bins < amplitude.shape[1] - 1]
            if not bins.size:
                continue
            here = amplitude[:, bins]
            peaks = (here > amplitude[:, bins - 1]) & (here >= amplitude[:, bins + 1])
            best = bins[np.where(peaks, here, 0.0).argmax(axis=1)]
            left, top, right = np.log(
                np.maximum([amplitude[rows, best + side] for side in (-1, 0, 1)], 1e-12)
            )
            curvature = np.minimum(left - 2.0 * top + right, -1e-9)
            offset = np.clip(0.5 * (left - right) / curvature, -0.5, 0.5)
            found = peaks.any(axis=1) & (top > np.log(WEAKEST))
            peak_hz = (best + offset) * self.bins_hz[1]
            halvings = np.floor(np.log2(peak_hz / UNDER_HZ)) + 1.0
            hz[:, voice] = np.where(found, peak_hz / 2.0**halvings, UNDER_HZ)
            level[:, voice] = np.where(found, np.exp(top), 0.0)
        return hz, level

"""A sine that has the frequency of the sound's spectral centroid, and the sound's envelope."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.baselines.hops import SineBaseline
from audioflinger_hook.transform import FloatArray

BAND_HZ = (30.0, 600.0)
OVERLAP = 8
STEPS_A_HOP = 8  # envelope steps in each hop; a step lasts 0.33 ms at 48 kHz
HOLD_S, RELEASE_S = 0.0015, 0.1


class Method(SineBaseline):
    """A sine at the spectral centroid of the frequencies from 30 to 600 Hz.

    The amplitude follows the envelope of the sound at all frequencies. The envelope rises at once,
    is held for 1.5 ms, and then decays by a factor e in 100 ms.
    """

    def __init__(self, samplerate: int, channels: int) -> None:
        super().__init__(samplerate, channels, voices=1, overlap=OVERLAP)
        self._band = (self.bins_hz >= BAND_HZ[0]) & (self.bins_hz <= BAND_HZ[1])
        step_s = self.hop / STEPS_A_HOP / samplerate
        self._held_steps = max(1, round(HOLD_S / step_s))
        self._fall = step_s / RELEASE_S  # decay of the envelope's logarithm for each step
        self._before = np.zeros(self._held_steps)
        self._log_level = -np.inf

    def lead(self, amplitude: FloatArray, newest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the centroid in Hz and the envelope at the end of each hop, both (hops, 1)."""
        band, bins_hz = amplitude[:, self._band], self.bins_hz[self._band]
        total = band.sum(axis=1)
        hz = (band @ bins_hz) / np.where(total > 0.0, total, 1.0)
        return hz[:, None], np.where(total > 0.0, self._envelope(newest), 0.0)[:, None]

    def _envelope(self, newest: FloatArray) -> FloatArray:
        hops = len(newest)
        pieces = newest.reshape(hops * STEPS_A_HOP, -1)
        steps = np.concatenate((self._before, np.sqrt((pieces**2).mean(axis=1))))
        self._before = steps[steps.size - self._held_steps :]
        held = np.lib.stride_tricks.sliding_window_view(steps, self._held_steps + 1).max(axis=1)
        # The envelope is the maximum of all earlier held values after their decay, computed with
        # logarithms.
        time = self._fall * np.arange(1.0, held.size + 1.0)
        with np.errstate(divide="ignore"):
            risen = np.concatenate(([self._log_level], np.log(held) + time))
        level = np.maximum.accumulate(risen)[1:] - time
        self._log_level = float(level[-1])
        at_ends: FloatArray = np.exp(level[STEPS_A_HOP - 1 :: STEPS_A_HOP])
        return at_ends

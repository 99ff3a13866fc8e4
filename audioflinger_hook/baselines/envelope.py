"""Vibration near 150 Hz with the envelope of the sound, like Android's HapticGenerator.

The sound passes a high-pass of 50 Hz, a low-pass of 9 kHz and a half-wave rectifier. A high-pass of
60 Hz, low-passes of 700, 400 and 500 Hz, and a band-pass at 150 Hz with Q 1 follow. Their output r
is multiplied by (level + 0.01)^-0.8, where the level is |r| after a low-pass of 5 Hz. A notch at
150 Hz (zeros of Q 8, poles of Q 4) compensates the resonance of an actuator. The last stages are
0.3 x, x^3 / (0.1 + x^2), a low-pass of 300 Hz, and 1.5 x / (1 + |x|). Here x is the input of the
stage. All filters are of second order.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import bilinear

from audioflinger_hook.baselines.stages import Baseline, Filter, high_pass, low_pass
from audioflinger_hook.transform import FloatArray

RESONANCE_HZ = 150.0
BAND_Q, ZERO_Q, POLE_Q = 1.0, 8.0, 4.0
LEVEL_HZ, LEVEL_OFFSET, LEVEL_POWER = 5.0, 0.01, -0.8
GAIN_IN, CUBE_THRESHOLD, GAIN_OUT = 0.3, 0.1, 1.5


class Method(Baseline):
    """The stages that the docstring of this module describes, in the same order."""

    def __init__(self, samplerate: int, channels: int) -> None:
        super().__init__(samplerate, channels)
        self._before = (high_pass(50.0, samplerate), low_pass(9_000.0, samplerate))
        self._after = (
            high_pass(60.0, samplerate),
            *(low_pass(corner_hz, samplerate) for corner_hz in (700.0, 400.0, 500.0)),
            resonator((0.0, 1.0 / BAND_Q, 0.0), BAND_Q, samplerate),
        )
        self._slow = low_pass(LEVEL_HZ, samplerate)
        self._notch = resonator((1.0, 1.0 / ZERO_Q, 1.0), POLE_Q, samplerate)
        self._last = low_pass(300.0, samplerate)

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return the output of the last stage."""
        for stage in self._before:
            sound = stage(sound)
        sound = np.maximum(sound, 0.0)
        for stage in self._after:
            sound = stage(sound)
        # A second-order low-pass undershoots slightly when a sound ends.
        level = np.maximum(self._slow(np.abs(sound)), 0.0) + LEVEL_OFFSET
        pushed = GAIN_IN * self._notch(sound * level**LEVEL_POWER)
        soft = self._last(pushed**3 / (CUBE_THRESHOLD + pushed**2))
        played: FloatArray = GAIN_OUT * soft / (1.0 + np.abs(soft))
        return played


def resonator(numerator: tuple[float, float, float], q: float, samplerate: int) -> Filter:
    """Return the filter numerator / (s^2 + s/Q + 1), where s = 1j corresponds to 150 Hz."""
    # The bilinear transform warps frequencies; this rate maps s = 1j exactly to the resonance.
    rate = 0.5 / np.tan(np.pi * RESONANCE_HZ / samplerate)
    b, a = bilinear(numerator, (1.0, 1.0 / q, 1.0), fs=rate)
    b = np.concatenate((np.zeros(3 - len(b)), b))
    return Filter(np.concatenate((b, a))[None, :])

"""The envelope on a resonance, as Android's HapticGenerator plays it.

High-pass 50 Hz, low-pass 9 kHz, half-wave rectifier, high-pass 60 Hz, low-passes 700, 400 and
500 Hz; band-pass on the resonance f0 with Q 1; levelled by (its slow envelope + 0.01)^-0.8; a notch
on f0 that takes away what an actuator of Q 8 adds (zeros of Q 8 over poles of Q 4); then 0.3 x,
x^3 / (0.1 + x^2), a low-pass at 300 Hz and 1.5 x / (1 + |x|). All filters of second order.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import bilinear

from audioflinger_hook.transform import FloatArray
from tools.bench.baselines.stages import Baseline, Filter, high_pass, low_pass

RESONANCE_HZ = 150.0
BAND_Q, ZERO_Q, POLE_Q = 1.0, 8.0, 4.0
LEVEL_HZ, LEVEL_OFFSET, LEVEL_POWER = 5.0, 0.01, -0.8
GAIN_IN, CUBE_THRESHOLD, GAIN_OUT = 0.3, 0.1, 1.5


class Method(Baseline):
    """The chain above; its automatic level brings quiet sounds near loud ones."""

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
        """Return the sound through the whole chain."""
        for stage in self._before:
            sound = stage(sound)
        sound = np.maximum(sound, 0.0)
        for stage in self._after:
            sound = stage(sound)
        # A second-order low-pass swings a little under 0 when a sound ends.
        level = np.maximum(self._slow(np.abs(sound)), 0.0) + LEVEL_OFFSET
        pushed = GAIN_IN * self._notch(sound * level**LEVEL_POWER)
        soft = self._last(pushed**3 / (CUBE_THRESHOLD + pushed**2))
        played: FloatArray = GAIN_OUT * soft / (1.0 + np.abs(soft))
        return played


def resonator(numerator: tuple[float, float, float], q: float, samplerate: int) -> Filter:
    """Return numerator / (s^2 + s/Q + 1), s in units of the resonance, exact at the resonance."""
    # The bilinear transform bends frequencies; at this rate it puts s = 1j on the resonance.
    rate = 0.5 / np.tan(np.pi * RESONANCE_HZ / samplerate)
    b, a = bilinear(numerator, (1.0, 1.0 / q, 1.0), fs=rate)
    b = np.concatenate((np.zeros(3 - len(b)), b))
    return Filter(np.concatenate((b, a))[None, :])

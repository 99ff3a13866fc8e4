"""A method that ignores the sound and gives the same vibration for any sound."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.baselines.stages import Baseline
from audioflinger_hook.transform import FloatArray

HZ, AMPLITUDE = 80.0, 0.1


class Method(Baseline):
    """A sine of 80 Hz with constant amplitude."""

    def __init__(self, samplerate: int, channels: int) -> None:
        super().__init__(samplerate, channels)
        self._frames = 0

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return the sine, with as many frames as the sound."""
        frames = self._frames + np.arange(sound.size)
        self._frames += sound.size
        sine: FloatArray = AMPLITUDE * np.sin(2.0 * np.pi * HZ / self.samplerate * frames)
        return sine

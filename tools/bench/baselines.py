"""The baselines of `audioflinger_hook.baselines` as subjects of the benchmarks."""

import numpy as np

from audioflinger_hook import baselines
from audioflinger_hook.baselines.stages import Baseline
from audioflinger_hook.transform import FloatArray
from tools.bench.workbench import Subject

HZ, AMPLITUDE = 80.0, 0.1


class Constant(Baseline):
    """A sine of 80 Hz with constant amplitude, which ignores the sound."""

    def __init__(self, samplerate: int, channels: int) -> None:
        super().__init__(samplerate, channels)
        self._frames = 0

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return the sine, with as many frames as the sound."""
        frames = self._frames + np.arange(sound.size)
        self._frames += sound.size
        return np.asarray(AMPLITUDE * np.sin(2.0 * np.pi * HZ / self.samplerate * frames))


BASELINES = tuple(
    Subject(name.replace("octave-fold", "octave fold"), method)
    for name, method in baselines.BASELINES.items()
)

NULL_MODELS = (Subject("constant", Constant),)
"""Methods that ignore the sound. If such a method does well on a measure, the measure says
little.
"""

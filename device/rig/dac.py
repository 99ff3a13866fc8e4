"""The digital-to-analogue converter: vibration in, volts out."""

import numpy as np

from device.rig.parameters import DacParameters
from device.units import Float32Array, FloatArray, finite_or_zero


class Dac:
    """Rounds to the converter's steps, saturates at full scale, and gives volts.

    Codes are two's complement: -1.0 to 1.0 less one step, rounded to nearest, ties to even; no
    dither. State: the two counts. One thread calls it.

    clipped_samples: samples beyond ±1.0 so far; 1.0 itself saturates by one step and is not
    counted. replaced_samples: samples that were not finite and became 0.
    """

    def __init__(self, parameters: DacParameters) -> None:
        self.parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Set the counts to 0."""
        self.clipped_samples = 0
        self.replaced_samples = 0

    def volts(self, vibration: FloatArray | Float32Array) -> FloatArray:
        """Volts of samples of any shape, in a new array of that shape."""
        samples, replaced = finite_or_zero(vibration.astype(np.float64, order="C"))
        self.replaced_samples += replaced
        self.clipped_samples += int(np.count_nonzero(np.abs(samples) > 1.0))
        codes = 2.0 ** (self.parameters.bits - 1)
        # Clipped first: a sample near the largest float64 would overflow.
        np.clip(samples, -1.0, 1.0 - 1.0 / codes, out=samples)
        samples *= codes
        np.rint(samples, out=samples)
        samples *= self.parameters.full_scale_v / codes
        return samples

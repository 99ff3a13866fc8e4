"""The power amplifier: line level in, the voltage that drives the actuator out."""

import numpy as np

from device.rig import AmplifierParameters
from device.units import FloatArray


class Amplifier:
    """A plain amplifier: gain, then clipping at its limit.

    Its source impedance is no business of the signal here: it stands in series in the actuator's
    circuit (`LinearActuator`). State: the count. One thread calls it.

    clipped_samples: samples beyond the limit so far.
    """

    def __init__(self, parameters: AmplifierParameters) -> None:
        self.parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Set the count to 0."""
        self.clipped_samples = 0

    def drive(self, volts: FloatArray) -> FloatArray:
        """Open-circuit output volts of finite input volts of any shape, in a new array."""
        limit = self.parameters.output_limit_v
        output = volts * self.parameters.gain
        self.clipped_samples += int(np.count_nonzero(np.abs(output) > limit))
        np.clip(output, -limit, limit, out=output)
        return output

"""The power amplifier: line level in, the voltage that drives the actuator out."""

import numpy as np

from device.rig.band import Band
from device.rig.parameters import AmplifierParameters
from device.units import FloatArray


class Amplifier:
    """A plain amplifier: gain, its band, then clipping at its limit.

    Its source impedance is no business of the signal here: it stands in series in the actuator's
    circuit (`LinearActuator`). Nor is its current limit: the twin counts where it would act.
    State: the band and the count. One thread calls it.

    samplerate: Hz. clipped_samples: samples beyond the limit so far.
    """

    def __init__(self, parameters: AmplifierParameters, samplerate: float = 48_000.0) -> None:
        self.parameters = parameters
        self._band = Band(parameters.low_cut_hz, parameters.high_cut_hz, samplerate)
        self.reset()

    def reset(self) -> None:
        """Come to rest and set the count to 0."""
        self._band.reset()
        self.clipped_samples = 0

    def drive(self, volts: FloatArray) -> FloatArray:
        """Open-circuit output, V, in a new array, for finite (frames,) or (frames, channels)."""
        limit = self.parameters.output_limit_v
        output = self._band.passed(volts * self.parameters.gain)
        self.clipped_samples += int(np.count_nonzero(np.abs(output) > limit))
        np.clip(output, -limit, limit, out=output)
        return output

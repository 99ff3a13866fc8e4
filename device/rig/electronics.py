"""DAC and power amplifier: from vibration samples to the voltage that drives the actuator."""

import numpy as np
import scipy
from numpy.typing import NDArray

from device.rig.parameters import AmplifierParameters, DacParameters
from device.units import Float32Array, FloatArray, finite_or_zero

_MAX_CORNER = 0.45
"""Corners above this share of the sample rate are left out."""


class Band:
    """A high-pass and a low-pass, Butterworth of second order. One thread calls `filter`.

    The corners are at -3 dB; 0 and infinity leave an end open.
    """

    def __init__(self, low_cut_hz: float, high_cut_hz: float, samplerate: float) -> None:
        self.samplerate = samplerate
        sections = [
            scipy.signal.butter(2, hz, kind, fs=samplerate, output="sos")
            for kind, hz in (("high", low_cut_hz), ("low", high_cut_hz))
            if 0.0 < hz < _MAX_CORNER * samplerate
        ]
        self.sections: FloatArray = np.concatenate([np.empty((0, 6)), *sections])
        self.reset()

    def reset(self) -> None:
        """Come to rest; the next block may have another number of channels."""
        self._state: FloatArray | None = None

    def filter(self, volts: FloatArray) -> FloatArray:
        """Return (frames,) or (frames, channels) filtered; the same array if nothing changes."""
        if not len(self.sections) or not len(volts):
            return volts
        if self._state is None:
            self._state = np.zeros((len(self.sections), 2, *volts.shape[1:]))
        filtered, self._state = scipy.signal.sosfilt(self.sections, volts, axis=0, zi=self._state)
        return np.asarray(filtered)

    def response(self, frequencies_hz: FloatArray) -> NDArray[np.complex128]:
        """Return the frequency response, (bins,)."""
        if not len(self.sections):
            return np.ones(len(frequencies_hz), np.complex128)
        _, found = scipy.signal.sosfreqz(self.sections, worN=frequencies_hz, fs=self.samplerate)
        return np.asarray(found, np.complex128)


class Dac:
    """A converter that rounds to its steps, saturates at full scale, and gives volts.

    Codes are two's complement: -1.0 to 1.0 less one step, rounded to nearest, ties to even,
    without dither. 1.0 saturates by one step and does not count as clipped. One thread calls it.
    """

    def __init__(self, parameters: DacParameters) -> None:
        self.parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Set the counts to 0."""
        self.clipped_samples = 0
        self.replaced_samples = 0  # were not finite and became 0

    def volts(self, vibration: FloatArray | Float32Array) -> FloatArray:
        """Return the volts for samples of any shape, in a new array."""
        samples, replaced = finite_or_zero(vibration.astype(np.float64, order="C"))
        self.replaced_samples += replaced
        self.clipped_samples += int(np.count_nonzero(np.abs(samples) > 1.0))
        codes = 2.0 ** (self.parameters.bits - 1)
        # Clip first: a sample near the largest float64 would overflow.
        np.clip(samples, -1.0, 1.0 - 1.0 / codes, out=samples)
        samples *= codes
        np.rint(samples, out=samples)
        samples *= self.parameters.full_scale_v / codes
        return samples


class Amplifier:
    """An amplifier with gain, band and clipping. One thread calls it.

    Its source impedance is part of the actuator's circuit (`LinearActuator`). Its current limit
    is not simulated: the simulated rig counts the samples beyond it.
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
        """Return the open-circuit output, V, for finite (frames,) or (frames, channels)."""
        limit = self.parameters.output_limit_v
        output = self._band.filter(volts * self.parameters.gain)
        self.clipped_samples += int(np.count_nonzero(np.abs(output) > limit))
        np.clip(output, -limit, limit, out=output)
        return output

"""The power amplifier: line level in, the voltage that drives the actuator out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfreqz

from device.rig.parameters import AmplifierParameters, DacParameters
from device.units import Float32Array, FloatArray, finite_or_zero

_OUT_OF_REACH = 0.45
"""A low-pass from this share of the sample rate on leaves all that can be there as it is."""


class Band:
    """Butterworth filters of second order at one sample rate, Hz. One thread calls `passed`.

    low_cut_hz, high_cut_hz: the corners, -3 dB; 0 and infinity leave an end open. A corner that
    the sample rate cannot show is left out.
    """

    def __init__(self, low_cut_hz: float, high_cut_hz: float, samplerate: float) -> None:
        self.samplerate = samplerate
        sections: list[NDArray[Any]] = []
        if 0.0 < low_cut_hz < _OUT_OF_REACH * samplerate:
            sections.append(butter(2, low_cut_hz, "high", fs=samplerate, output="sos"))
        if high_cut_hz < _OUT_OF_REACH * samplerate:
            sections.append(butter(2, high_cut_hz, "low", fs=samplerate, output="sos"))
        self._sections = np.concatenate(sections) if sections else np.empty((0, 6))
        self.reset()

    @property
    def sections(self) -> FloatArray:
        """(n, 6): the second-order sections, n 0 to 2; not to be written to."""
        return self._sections

    def reset(self) -> None:
        """Come to rest; the next block may have another number of channels."""
        self._state: FloatArray | None = None

    def passed(self, volts: FloatArray) -> FloatArray:
        """(frames,) or (frames, channels) filtered; the same array where nothing is to be done."""
        if not len(self._sections) or not len(volts):
            return volts
        if self._state is None:
            self._state = np.zeros((len(self._sections), 2, *volts.shape[1:]))
        filtered, self._state = sosfilt(self._sections, volts, axis=0, zi=self._state)
        return np.asarray(filtered)

    def response(self, frequencies_hz: FloatArray) -> NDArray[np.complex128]:
        """What it does to each frequency, Hz, (bins,): for taking it out of a measurement."""
        if not len(self._sections):
            return np.ones(len(frequencies_hz), np.complex128)
        _, found = sosfreqz(self._sections, worN=frequencies_hz, fs=self.samplerate)
        return np.asarray(found, np.complex128)


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

"""Electronics of a rig: DAC and amplifier before the actuator, accelerometer to DAQ after it."""

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from device.errors import UsageError
from device.rig.parameters import AmplifierParameters, DacParameters, DaqParameters
from device.rig.rig import Rig
from device.units import Float32Array, FloatArray, finite_or_zero

_MAX_CORNER = 0.45  # corners above this share of the sample rate are omitted
CONDITIONING_V_PER_M_S2 = 0.01  # gain of the conditioning amplifier (Type 2692 class)
ACCELERATION_FULL_SCALE_M_S2 = 1.0 / CONDITIONING_V_PER_M_S2  # for a recorded sample of 1.0 (1 V)
_NOISE_BAND = math.pi / (2.0 * math.sqrt(2.0))  # noise bandwidth / corner of the low-pass


class Band:
    """Second-order high-pass and low-pass, each omitted unless 0 < corner < 0.45 samplerate."""

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
        """Reset the state; the next block may have another number of channels."""
        self._state: FloatArray | None = None

    def filter(self, volts: FloatArray) -> FloatArray:
        """Return filtered volts, (frames,) or (frames, channels); without filters, `volts`."""
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
    """A converter from samples to volts. One thread calls it.

    Samples are rounded to the nearest step, ties to even, without dither. The largest output is one
    step below full scale. A sample of 1.0 is lowered by one step and does not count as clipped.
    """

    def __init__(self, parameters: DacParameters) -> None:
        self.parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Set the counts to 0."""
        self.clipped_samples = 0
        self.replaced_samples = 0  # samples that were not finite and became 0

    def volts(self, vibration: FloatArray | Float32Array) -> FloatArray:
        """Return the volts for samples of any shape, in a new array."""
        samples, replaced = finite_or_zero(vibration.astype(np.float64, order="C"))
        self.replaced_samples += replaced
        self.clipped_samples += int(np.count_nonzero(np.abs(samples) > 1.0))
        codes = 2.0 ** (self.parameters.bits - 1)
        # Clip first: the product of a sample near the largest float64 would overflow.
        np.clip(samples, -1.0, 1.0 - 1.0 / codes, out=samples)
        samples *= codes
        np.rint(samples, out=samples)
        samples *= self.parameters.full_scale_v / codes
        return samples


class Amplifier:
    """An amplifier with gain, high-pass, low-pass and clipping. One thread calls it.

    Its source impedance is part of the actuator's circuit (`LinearActuator`). Its current limit is
    not simulated: the simulated rig counts the samples beyond the limit.
    """

    def __init__(self, parameters: AmplifierParameters, samplerate: float = 48_000.0) -> None:
        self.parameters = parameters
        self._band = Band(parameters.low_cut_hz, parameters.high_cut_hz, samplerate)
        self.reset()

    def reset(self) -> None:
        """Reset the filters and the count of clipped samples."""
        self._band.reset()
        self.clipped_samples = 0

    def drive(self, volts: FloatArray) -> FloatArray:
        """Return the open-circuit output in V. volts: finite, (frames,) or (frames, channels)."""
        limit = self.parameters.output_limit_v
        output = self._band.filter(volts * self.parameters.gain)
        self.clipped_samples += int(np.count_nonzero(np.abs(output) > limit))
        np.clip(output, -limit, limit, out=output)
        return output


class Daq:
    """A DAQ input: adds noise to volts and quantises them. One thread calls it."""

    def __init__(self, parameters: DaqParameters, samplerate: float, seed: int) -> None:
        if samplerate > parameters.max_samplerate_hz:
            raise UsageError(
                f"samplerate={samplerate!r} Hz is beyond the DAQ's "
                f"max_samplerate_hz={parameters.max_samplerate_hz!r}; choose a lower one"
            )
        self._parameters = parameters
        self._random = np.random.default_rng(seed)
        self.clipped_samples = 0

    def volts(self, volts: FloatArray) -> FloatArray:
        """Return the digitised volts, (frames,) or (frames, channels), in a new array."""
        p = self._parameters
        step_v = p.range_v / 2.0 ** (p.bits - 1)
        noisy = volts + p.noise_v * self._random.standard_normal(volts.shape)
        self.clipped_samples += int(np.count_nonzero(np.abs(noisy) > p.range_v))
        return np.asarray(np.rint(np.clip(noisy, -p.range_v, p.range_v - step_v) / step_v) * step_v)


class InstrumentChain:
    """Accelerometer, conditioning amplifier and DAQ in series. One thread calls it."""

    def __init__(self, rig: Rig, samplerate: float, seed: int = 0) -> None:
        if not (rig.accelerometer and rig.conditioning and rig.daq):
            chain = ("accelerometer", "conditioning", "daq")
            absent = ", ".join(f"[{name}]" for name in chain if getattr(rig, name) is None)
            raise UsageError(f"rig {rig.name!r} describes no {absent}; add it to its file")
        self._sensor = rig.accelerometer
        p = self._conditioning = rig.conditioning
        self.band = Band(p.low_cut_hz, p.high_cut_hz, samplerate)
        self._random = np.random.default_rng(seed)
        # The sampled band contains only a part of the noise in the whole band.
        whole_hz = _NOISE_BAND * p.high_cut_hz if math.isfinite(p.high_cut_hz) else samplerate / 2
        self._noise_pc = p.noise_pc * math.sqrt(samplerate / 2.0 / whole_hz)
        self._daq = Daq(rig.daq, samplerate, seed + 1)
        self._clipped_samples = 0
        self.v_per_m_s2 = self._sensor.sensitivity_pc_per_m_s2 * p.gain_v_per_pc

    @property
    def clipped_samples(self) -> int:
        """Number of samples that any stage has clipped."""
        return self._clipped_samples + self._daq.clipped_samples

    def acceleration_m_s2(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """Return the measured acceleration, (frames,) or (frames, channels), in a new array."""
        sensor, p = self._sensor, self._conditioning
        charge_pc = self._clip(acceleration_m_s2, sensor.limit_m_s2)
        charge_pc *= sensor.sensitivity_pc_per_m_s2
        charge_pc += self._noise_pc * self._random.standard_normal(charge_pc.shape)
        volts = self._clip(self.band.filter(charge_pc * p.gain_v_per_pc), p.output_limit_v)
        return np.asarray(self._daq.volts(volts) / self.v_per_m_s2)

    def _clip(self, samples: FloatArray, limit: float) -> FloatArray:
        self._clipped_samples += int(np.count_nonzero(np.abs(samples) > limit))
        return np.clip(samples, -limit, limit)

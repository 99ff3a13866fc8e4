"""The instruments that look at the seat: accelerometer, conditioning amplifier and DAQ.

`AccelerometerChain` is what a twin's recorder shows, ideal within the band of vibration.
`InstrumentChain` is what a laboratory gets of the same motion, with noise, steps and limits.
"""

import math

import numpy as np
from numpy.typing import NDArray

from device.errors import UsageError
from device.rig.electronics import Band
from device.rig.parameters import (
    AccelerometerParameters,
    ConditioningParameters,
    DaqParameters,
)
from device.rig.rig import Rig
from device.units import FloatArray

CONDITIONING_V_PER_M_S2 = 0.01
"""Output of the conditioning amplifier (Type 2692 class): 10 mV per m/s^2."""

ACCELERATION_FULL_SCALE_M_S2 = 1.0 / CONDITIONING_V_PER_M_S2
"""The acceleration that a recording shows as 1.0, which is 1 V: 100 m/s^2."""

_NOISE_BAND = math.pi / (2.0 * math.sqrt(2.0))
"""Noise bandwidth of a Butterworth low-pass of second order, in corners."""


class AccelerometerChain:
    """Acceleration in, volts out; ideal within the band of vibration. It holds no state."""

    def volts(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """Volts for m/s^2, any shape, in a new array; 1.0 V is ACCELERATION_FULL_SCALE_M_S2."""
        return acceleration_m_s2 * CONDITIONING_V_PER_M_S2


class Accelerometer:
    """Acceleration in, charge out. State: the count. One thread calls it.

    Its resonance lies far above any band of vibration and is not simulated; `rise` says what that
    leaves out. clipped_samples: samples beyond its limit so far.
    """

    def __init__(self, parameters: AccelerometerParameters) -> None:
        self.parameters = parameters
        self.clipped_samples = 0

    def charge_pc(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """pC for m/s^2, any shape, in a new array."""
        limit = self.parameters.limit_m_s2
        self.clipped_samples += int(np.count_nonzero(np.abs(acceleration_m_s2) > limit))
        shown = np.clip(acceleration_m_s2, -limit, limit)
        return np.asarray(shown * self.parameters.sensitivity_pc_per_m_s2)

    def rise(self, frequency_hz: float) -> float:
        """The share it gives beyond its sensitivity at a frequency: 7e-6 at 220 Hz."""
        p = self.parameters
        ratio = frequency_hz / p.resonance_hz
        return abs(1.0 / complex(1.0 - ratio**2, ratio / p.q_resonance)) - 1.0


class ConditioningAmplifier:
    """Charge in, volts out, with noise, between its corners and limits. One thread calls it.

    samplerate: Hz; seed: of its noise. clipped_samples: samples beyond its limit so far.
    """

    def __init__(self, parameters: ConditioningParameters, samplerate: float, seed: int) -> None:
        p = self.parameters = parameters
        self._band = Band(p.low_cut_hz, p.high_cut_hz, samplerate)
        self._random = np.random.default_rng(seed)
        # Of the noise in its whole band, the share that the sample rate shows.
        whole_hz = _NOISE_BAND * p.high_cut_hz if math.isfinite(p.high_cut_hz) else samplerate / 2
        self._noise_pc = p.noise_pc * math.sqrt(samplerate / 2.0 / whole_hz)
        self.clipped_samples = 0

    def volts(self, charge_pc: FloatArray) -> FloatArray:
        """Volts for pC, (frames,) or (frames, channels), in a new array."""
        p = self.parameters
        noisy = charge_pc + self._noise_pc * self._random.standard_normal(charge_pc.shape)
        output = self._band.passed(noisy * p.gain_v_per_pc)
        self.clipped_samples += int(np.count_nonzero(np.abs(output) > p.output_limit_v))
        return np.clip(output, -p.output_limit_v, p.output_limit_v)

    def response(self, frequencies_hz: FloatArray) -> NDArray[np.complex128]:
        """What its corners do to each frequency, Hz, (bins,); its gain is not in it."""
        return self._band.response(frequencies_hz)


class Daq:
    """Volts in, volts out as its codes have them, with its noise. One thread calls it.

    seed: of its noise. clipped_samples: samples beyond its range so far.

    Raises
    ------
    UsageError
        The rate is beyond its highest.
    """

    def __init__(self, parameters: DaqParameters, samplerate: float, seed: int) -> None:
        if samplerate > parameters.max_samplerate_hz:
            raise UsageError(
                f"samplerate={samplerate!r} Hz is beyond the DAQ's "
                f"max_samplerate_hz={parameters.max_samplerate_hz!r}; choose a lower one"
            )
        self.parameters = parameters
        self._random = np.random.default_rng(seed)
        self.clipped_samples = 0

    def volts(self, volts: FloatArray) -> FloatArray:
        """What it reads, (frames,) or (frames, channels), in a new array."""
        p = self.parameters
        step_v = p.range_v / 2.0 ** (p.bits - 1)
        noisy = volts + p.noise_v * self._random.standard_normal(volts.shape)
        self.clipped_samples += int(np.count_nonzero(np.abs(noisy) > p.range_v))
        return np.asarray(np.rint(np.clip(noisy, -p.range_v, p.range_v - step_v) / step_v) * step_v)


class InstrumentChain:
    """Acceleration in, what the laboratory reads of it out. One thread calls it.

    seed: of all noise; the same gives the same bytes, however the signal is split.

    Raises
    ------
    UsageError
        The rig describes no instruments, or the rate is beyond them.
    """

    def __init__(self, rig: Rig, samplerate: float, seed: int = 0) -> None:
        absent = [n for n in ("accelerometer", "conditioning", "daq") if getattr(rig, n) is None]
        if not (rig.accelerometer and rig.conditioning and rig.daq):
            raise UsageError(
                f"rig {rig.name!r} describes no {', '.join(f'[{name}]' for name in absent)}; "
                "add it to its file"
            )
        self.accelerometer = Accelerometer(rig.accelerometer)
        self.conditioning = ConditioningAmplifier(rig.conditioning, samplerate, seed)
        self.daq = Daq(rig.daq, samplerate, seed + 1)
        self.v_per_m_s2 = rig.accelerometer.sensitivity_pc_per_m_s2 * rig.conditioning.gain_v_per_pc

    @property
    def clipped_samples(self) -> int:
        """Samples so far that any of them clipped."""
        stages = (self.accelerometer, self.conditioning, self.daq)
        return sum(stage.clipped_samples for stage in stages)

    def acceleration_m_s2(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """What is read, in m/s^2, of (frames,) or (frames, channels), in a new array."""
        charge = self.accelerometer.charge_pc(acceleration_m_s2)
        return np.asarray(self.daq.volts(self.conditioning.volts(charge)) / self.v_per_m_s2)

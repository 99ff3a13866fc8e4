"""The instruments at the seat: accelerometer, conditioning amplifier and DAQ."""

import math

import numpy as np
from numpy.typing import NDArray

from device.errors import UsageError
from device.rig.electronics import Band
from device.rig.parameters import AccelerometerParameters, ConditioningParameters, DaqParameters
from device.rig.rig import Rig
from device.units import FloatArray

CONDITIONING_V_PER_M_S2 = 0.01
"""Output of the conditioning amplifier (Type 2692 class): 10 mV per m/s^2."""

ACCELERATION_FULL_SCALE_M_S2 = 1.0 / CONDITIONING_V_PER_M_S2
"""A recorded sample of 1.0 is 1 V, which is 100 m/s^2."""

_NOISE_BAND = math.pi / (2.0 * math.sqrt(2.0))
"""Noise bandwidth of a Butterworth low-pass of second order, as a multiple of its corner."""


class Accelerometer:
    """Acceleration in, charge out. One thread calls it.

    Its resonance lies far above the vibration and is not simulated: at 220 Hz that omits 7e-6.

    Attributes
    ----------
    clipped_samples : int
        Samples beyond its limit so far.
    """

    def __init__(self, parameters: AccelerometerParameters) -> None:
        self.parameters = parameters
        self.clipped_samples = 0

    def charge_pc(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """Return pC for m/s^2, any shape, in a new array."""
        limit = self.parameters.limit_m_s2
        self.clipped_samples += int(np.count_nonzero(np.abs(acceleration_m_s2) > limit))
        shown = np.clip(acceleration_m_s2, -limit, limit)
        return np.asarray(shown * self.parameters.sensitivity_pc_per_m_s2)


class ConditioningAmplifier:
    """Charge in, volts out, with noise, band and limit. One thread calls it.

    Attributes
    ----------
    clipped_samples : int
        Samples beyond its limit so far.
    """

    def __init__(self, parameters: ConditioningParameters, samplerate: float, seed: int) -> None:
        p = self.parameters = parameters
        self._band = Band(p.low_cut_hz, p.high_cut_hz, samplerate)
        self._random = np.random.default_rng(seed)
        # The sample rate shows only a part of the noise in its whole band.
        whole_hz = _NOISE_BAND * p.high_cut_hz if math.isfinite(p.high_cut_hz) else samplerate / 2
        self._noise_pc = p.noise_pc * math.sqrt(samplerate / 2.0 / whole_hz)
        self.clipped_samples = 0

    def volts(self, charge_pc: FloatArray) -> FloatArray:
        """Return volts for pC, (frames,) or (frames, channels), in a new array."""
        p = self.parameters
        noisy = charge_pc + self._noise_pc * self._random.standard_normal(charge_pc.shape)
        output = self._band.filter(noisy * p.gain_v_per_pc)
        self.clipped_samples += int(np.count_nonzero(np.abs(output) > p.output_limit_v))
        return np.clip(output, -p.output_limit_v, p.output_limit_v)

    def response(self, frequencies_hz: FloatArray) -> NDArray[np.complex128]:
        """Return the frequency response of its band, (bins,), without its gain."""
        return self._band.response(frequencies_hz)


class Daq:
    """Volts in, quantised volts out, with noise. One thread calls it.

    Attributes
    ----------
    clipped_samples : int
        Samples beyond its range so far.

    Raises
    ------
    UsageError
        The sample rate is above its highest.
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
        """Return what it reads, (frames,) or (frames, channels), in a new array."""
        p = self.parameters
        step_v = p.range_v / 2.0 ** (p.bits - 1)
        noisy = volts + p.noise_v * self._random.standard_normal(volts.shape)
        self.clipped_samples += int(np.count_nonzero(np.abs(noisy) > p.range_v))
        return np.asarray(np.rint(np.clip(noisy, -p.range_v, p.range_v - step_v) / step_v) * step_v)


class InstrumentChain:
    """Acceleration in, the laboratory's reading of it out. One thread calls it.

    Parameters
    ----------
    rig : Rig
        It must describe accelerometer, conditioning amplifier and DAQ.
    samplerate : float
        Hz.
    seed : int
        Seed of all noise. The output does not depend on how the signal is split into blocks.

    Raises
    ------
    UsageError
        The rig describes no instruments, or the rate is too high for them.
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
        """Return the reading, m/s^2, of (frames,) or (frames, channels), in a new array."""
        charge = self.accelerometer.charge_pc(acceleration_m_s2)
        return np.asarray(self.daq.volts(self.conditioning.volts(charge)) / self.v_per_m_s2)

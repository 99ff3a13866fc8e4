"""The instruments at the seat: accelerometer, conditioning amplifier and DAQ."""

import math

import numpy as np

from device.errors import UsageError
from device.rig.electronics import Band
from device.rig.parameters import DaqParameters
from device.rig.rig import Rig
from device.units import FloatArray

CONDITIONING_V_PER_M_S2 = 0.01
"""Output of the conditioning amplifier (Type 2692 class): 10 mV per m/s^2."""

ACCELERATION_FULL_SCALE_M_S2 = 1.0 / CONDITIONING_V_PER_M_S2
"""A recorded sample of 1.0 is 1 V, which is 100 m/s^2."""

_NOISE_BAND = math.pi / (2.0 * math.sqrt(2.0))
"""Noise bandwidth of a Butterworth low-pass of second order, as a multiple of its corner."""


class Daq:
    """Volts in, quantised volts out, with noise. One thread calls it."""

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
        """Return what it reads, (frames,) or (frames, channels), in a new array."""
        p = self._parameters
        step_v = p.range_v / 2.0 ** (p.bits - 1)
        noisy = volts + p.noise_v * self._random.standard_normal(volts.shape)
        self.clipped_samples += int(np.count_nonzero(np.abs(noisy) > p.range_v))
        return np.asarray(np.rint(np.clip(noisy, -p.range_v, p.range_v - step_v) / step_v) * step_v)


class InstrumentChain:
    """Acceleration in, the laboratory's reading of it out. One thread calls it.

    The output does not depend on how the signal is split into blocks. The accelerometer's resonance
    lies far above the vibration and is not simulated: at 220 Hz that omits 7e-6.
    """

    def __init__(self, rig: Rig, samplerate: float, seed: int = 0) -> None:
        if not (rig.accelerometer and rig.conditioning and rig.daq):
            chain = ("accelerometer", "conditioning", "daq")
            absent = ", ".join(f"[{name}]" for name in chain if getattr(rig, name) is None)
            raise UsageError(f"rig {rig.name!r} describes no {absent}; add it to its file")
        self._sensor = rig.accelerometer
        p = self._conditioning = rig.conditioning
        self.band = Band(p.low_cut_hz, p.high_cut_hz, samplerate)
        self._random = np.random.default_rng(seed)
        # The sample rate shows only a part of the noise in its whole band.
        whole_hz = _NOISE_BAND * p.high_cut_hz if math.isfinite(p.high_cut_hz) else samplerate / 2
        self._noise_pc = p.noise_pc * math.sqrt(samplerate / 2.0 / whole_hz)
        self._daq = Daq(rig.daq, samplerate, seed + 1)
        self._clipped_samples = 0
        self.v_per_m_s2 = self._sensor.sensitivity_pc_per_m_s2 * p.gain_v_per_pc

    @property
    def clipped_samples(self) -> int:
        """Samples so far that any of them clipped."""
        return self._clipped_samples + self._daq.clipped_samples

    def acceleration_m_s2(self, acceleration_m_s2: FloatArray) -> FloatArray:
        """Return the reading, m/s^2, of (frames,) or (frames, channels), in a new array."""
        sensor, p = self._sensor, self._conditioning
        charge_pc = self._clip(acceleration_m_s2, sensor.limit_m_s2)
        charge_pc *= sensor.sensitivity_pc_per_m_s2
        charge_pc += self._noise_pc * self._random.standard_normal(charge_pc.shape)
        volts = self._clip(self.band.filter(charge_pc * p.gain_v_per_pc), p.output_limit_v)
        return np.asarray(self._daq.volts(volts) / self.v_per_m_s2)

    def _clip(self, samples: FloatArray, limit: float) -> FloatArray:
        self._clipped_samples += int(np.count_nonzero(np.abs(samples) > limit))
        return np.clip(samples, -limit, limit)

"""Measures of the ringing after a burst: residual energy, settling time and peak volts.

Definitions, for a 50 ms burst of a sine at the f0 of the rig as identified:

- residual: energy of the acceleration after the burst's end over that within it.
- settling: time after the end until the acceleration stays under 10 % of the burst's peak.
- peak volts: at the actuator's terminals, for the same r.m.s. acceleration within the burst.
- detuning: the true stiffness gives another f0; mass and friction are as believed. Filter and
  burst do not change.
- mass: the true moving mass over the believed one.
"""

import math
from dataclasses import dataclass

import numpy as np

from device.drive.damping.design import Damping, no_damping
from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator
from device.rig.parameters import detune, vary
from device.units import FloatArray, amplitude_to_db

BURST_S = 0.05
SETTLED = 0.1
CURRENT_DRIVE_OHM = 1e5
"""A source impedance so large that the actuator's 3.3 ohm are negligible (3e-5)."""

SAMPLERATE = 48_000
_DECAYS = 12.0
"""Number of time constants of the slowest mode after the burst: e^-24 of its energy remains."""


@dataclass(frozen=True)
class BurstResponse:
    """The response to one burst; see the definitions above."""

    residual: float  # energy after the burst, as a share of that within it
    settling_s: float
    peak_v: float  # for 1 m/s² r.m.s. within the burst
    rms_m_s2: float  # in the burst, for a drive of 1 V (current source: about 1 A)

    def against(self, reference: "BurstResponse") -> "Residual":
        """Return the difference from another response in dB."""
        return Residual(
            residual_db=amplitude_to_db(math.sqrt(self.residual / reference.residual)),
            settling_s=self.settling_s,
            peak_volts_db=amplitude_to_db(self.peak_v / reference.peak_v),
        )


@dataclass(frozen=True)
class Residual:
    """A burst against a reference: residual energy and peak volts in dB, and the settling time."""

    residual_db: float
    settling_s: float
    peak_volts_db: float


def burst_response(
    p: ActuatorParameters, damping: Damping, *, detuning: float = 0.0, mass: float = 1.0
) -> BurstResponse:
    """Return the response of the linear model; see the definitions above.

    p: the believed actuator; detuning: share by which the true f0 differs.
    """
    true, source = vary(detune(p, detuning), mass), damping.source_impedance_ohm
    frames = round((BURST_S + max(decay_s(true, source), BURST_S)) * SAMPLERATE)
    burst = sine_burst(frames, BURST_S, p.resonance_hz)
    # Scaled so that a current source gives about the same volts.
    drive = damping.filtered(burst, SAMPLERATE) * (1.0 + source)
    actuator = LinearActuator(true, SAMPLERATE, source)
    motion = actuator.move(drive, ("acceleration_m_s2", "current_a"))
    return measured(motion.acceleration_m_s2, drive - source * motion.current_a)


def measured(acceleration_m_s2: FloatArray, volts: FloatArray) -> BurstResponse:
    """Return the response to a burst from 0 on. Acceleration, terminal volts: (frames,)."""
    end = round(BURST_S * SAMPLERATE)
    within, after = acceleration_m_s2[:end], acceleration_m_s2[end:]
    rms_m_s2 = math.sqrt(np.sum(within**2) / (BURST_S * SAMPLERATE))
    loud = np.flatnonzero(np.abs(after) > SETTLED * np.abs(within).max())
    return BurstResponse(
        residual=float(np.sum(after**2) / np.sum(within**2)),
        settling_s=float((loud[-1] + 1) / SAMPLERATE) if loud.size else 0.0,
        peak_v=float(np.abs(volts).max()) / rms_m_s2,
        rms_m_s2=rms_m_s2,
    )


def undamped(p: ActuatorParameters, *, detuning: float = 0.0) -> BurstResponse:
    """Return the reference: current drive, so that only the actuator's friction damps."""
    return burst_response(p, no_damping(CURRENT_DRIVE_OHM), detuning=detuning)


def decay_s(p: ActuatorParameters, source_impedance_ohm: float) -> float:
    """Return the time after a burst in which the energy falls to e^-24."""
    return _DECAYS * p.q_total(source_impedance_ohm) / (math.pi * p.resonance_hz)


def sine_burst(frames: int, burst_s: float, frequency_hz: float) -> FloatArray:
    """Return a sine from 0, then silence, (frames,)."""
    burst = np.zeros(frames)
    burst_frames = round(burst_s * SAMPLERATE)
    phase = math.tau * frequency_hz / SAMPLERATE * np.arange(burst_frames)
    burst[:burst_frames] = np.sin(phase)
    return burst

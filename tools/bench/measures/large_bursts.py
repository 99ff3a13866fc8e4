"""What a burst leaves behind at any level: the definitions of residual.py on the non-linear model.

The level is the intended excursion: the largest one that the believed linear rig would reach
within the burst. The rig may reach another one, since it stiffens and its f0 may differ; both are
reported. Dampings are compared at the same intended excursion.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from device.drive.damping.damper import Damper
from device.drive.damping.design import Damping, no_damping
from device.drive.damping.flat_inverse import FlatInverse
from device.drive.damping.residual import (
    BURST_S,
    SAMPLERATE,
    BurstResponse,
    decay_s,
    measured,
    sine_burst,
)
from device.errors import UsageError
from device.rig import Rig
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import ModelLevel
from device.rig.parameters import detune
from device.units import FloatArray

CURRENT_DRIVE_OHM = 1e4
"""Lower than in residual.py: a shorter L / R would cost twenty times as much. The actuator's
3.3 ohm count for 3e-4."""


@dataclass(frozen=True)
class LargeBurst:
    """One burst on the non-linear model: its response, and the largest excursion in m."""

    response: BurstResponse
    excursion_m: float


def large_burst_response(
    rig: Rig, damping: Damping, excursion_m: float, *, flat: bool = False, detuning: float = 0.0
) -> LargeBurst:
    """Return a 50 ms burst at the believed f0 on the non-linear model; takes about 10 ms.

    rig: as believed; its amplifier gets the damping's source impedance and has no band or limits.
    excursion_m: intended, above 0. flat: apply `FlatInverse` of the believed rig after the damping.
    detuning: share by which the true f0 differs.

    Raises
    ------
    UsageError
        The excursion is not above 0, or `flat` needs a rig with [large_signal].
    """
    if not (math.isfinite(excursion_m) and excursion_m > 0.0):
        raise UsageError(f"excursion_m={excursion_m!r} of a burst must be above 0; correct it")
    believed = driven_by(rig, damping.source_impedance_ohm)
    source = damping.source_impedance_ohm
    true = replace(believed, actuator=detune(rig.actuator, detuning))
    watched_s = BURST_S + max(decay_s(true.actuator, source), BURST_S) + damping.latency_s
    burst = sine_burst(round(watched_s * SAMPLERATE), BURST_S, rig.actuator.resonance_hz)
    drive = intended(believed, damping, burst, excursion_m)
    if flat:
        drive = FlatInverse(believed, SAMPLERATE).process(drive)
    motion = AdaptiveActuator(true, SAMPLERATE, level=ModelLevel.NONLINEAR).move(
        drive, ("displacement_m", "acceleration_m_s2", "current_a")
    )
    volts = drive - source * motion.current_a
    return LargeBurst(
        measured(motion.acceleration_m_s2, volts, BURST_S, damping.latency_s),
        float(np.abs(motion.displacement_m).max()),
    )


def undamped_large(rig: Rig, excursion_m: float, *, detuning: float = 0.0) -> LargeBurst:
    """Return the reference: current drive of the same rig at the same intended excursion."""
    return large_burst_response(rig, no_damping(CURRENT_DRIVE_OHM), excursion_m, detuning=detuning)


def driven_by(rig: Rig, source_impedance_ohm: float) -> Rig:
    """Return the rig behind an amplifier of that source impedance."""
    current = source_impedance_ohm > rig.actuator.resistance_ohm
    return replace(
        rig,
        amplifier=replace(
            rig.amplifier,
            source_impedance_ohm=source_impedance_ohm,
            drive_mode="current" if current else "voltage",
        ),
    )


def intended(
    rig: Rig,
    damping: Damping,
    signal: FloatArray,
    excursion_m: float,
    samplerate: int = SAMPLERATE,
) -> FloatArray:
    """Return the damped signal in V, (frames,), that takes the linear rig to the excursion."""
    drive = Damper(damping, samplerate, 1).process(signal[:, None].astype(np.float64))[:, 0]
    source = rig.amplifier.source_impedance_ohm
    linear = LinearActuator(rig.actuator, samplerate, source).move(drive, ("displacement_m",))
    scaled: FloatArray = drive * (excursion_m / float(np.abs(linear.displacement_m).max()))
    return scaled

"""What a burst leaves behind at any level: the definitions of residual.py on the non-linear model.

The level is the intended excursion: the largest one that the believed linear rig would reach
within the burst. The rig may reach another one, since it stiffens and its f0 may differ; both are
reported. Dampings are compared at the same intended excursion.
"""

from dataclasses import dataclass, replace

import numpy as np

from device.drive.damping import (
    BURST_S,
    SAMPLERATE,
    BurstResponse,
    Damping,
    decay_s,
    measured,
    sine_burst,
)
from device.rig import Rig
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.parameters import DriveMode, detune
from tools.bench.measures.flat_inverse import FlatInverse

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
    """
    source = damping.source_impedance_ohm
    mode: DriveMode = "current" if source > rig.actuator.resistance_ohm else "voltage"
    amplifier = replace(rig.amplifier, source_impedance_ohm=source, drive_mode=mode)
    believed = replace(rig, amplifier=amplifier)
    true = replace(believed, actuator=detune(rig.actuator, detuning))
    watched_s = BURST_S + max(decay_s(true.actuator, source), BURST_S)
    burst = sine_burst(round(watched_s * SAMPLERATE), BURST_S, rig.actuator.resonance_hz)
    drive = damping.filtered(burst, SAMPLERATE)
    linear = LinearActuator(rig.actuator, SAMPLERATE, source).move(drive, ("displacement_m",))
    drive *= excursion_m / float(np.abs(linear.displacement_m).max())
    if flat:
        drive = FlatInverse(believed, SAMPLERATE).process(drive)
    motion = AdaptiveActuator(true, SAMPLERATE, model="nonlinear").move(
        drive, ("displacement_m", "acceleration_m_s2", "current_a")
    )
    volts = drive - source * motion.current_a
    return LargeBurst(
        measured(motion.acceleration_m_s2, volts),
        float(np.abs(motion.displacement_m).max()),
    )


def undamped_large(rig: Rig, excursion_m: float, *, detuning: float = 0.0) -> LargeBurst:
    """Return the reference: current drive of the same rig at the same intended excursion."""
    return large_burst_response(rig, Damping(CURRENT_DRIVE_OHM), excursion_m, detuning=detuning)

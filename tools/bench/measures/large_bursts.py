"""Response of the non-linear model of a rig to a short sine burst.

The assumed rig is the one whose parameters are known; the true rig may have another resonance. The
strength of a burst is the intended excursion: the peak excursion of the assumed rig's linear model.
The non-linear model may reach another peak excursion. Methods of damping are compared at the same
intended excursion.
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
"""Source resistance in ohm. A larger resistance would shorten L / R and need more steps. The
actuator's 3.3 ohm cause an error of 3e-4.
"""


@dataclass(frozen=True)
class LargeBurst:
    """Response of the non-linear model to one burst.

    excursion_m: peak excursion that the model reached, in m.
    """

    response: BurstResponse
    excursion_m: float


def large_burst_response(
    rig: Rig, damping: Damping, excursion_m: float, *, flat: bool = False, detuning: float = 0.0
) -> LargeBurst:
    """Return the response to a 50 ms sine burst at the resonance frequency of the assumed rig.

    rig: the assumed rig; its amplifier gets the source impedance of `damping`, and no voltage
        limit.
    excursion_m: intended excursion in m, above 0.
    flat: whether to apply the `FlatInverse` of the assumed rig after the damping.
    detuning: relative deviation of the true from the assumed resonance frequency.
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
        measured(motion.acceleration_m_s2, volts), float(np.abs(motion.displacement_m).max())
    )


def undamped_large(rig: Rig, excursion_m: float, *, detuning: float = 0.0) -> LargeBurst:
    """Return the response with current drive, which does not damp the rig."""
    return large_burst_response(rig, Damping(CURRENT_DRIVE_OHM), excursion_m, detuning=detuning)

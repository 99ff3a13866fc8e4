"""The electrical side of a rig from its impedance: Re, Le, f0, Qms, Qes, with intervals."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from device.identification import responses
from device.identification.acceleration import (
    F0_BY_LEVEL,
    MOST_MISFIT,
    Q_BY_LEVEL,
    bent_square,
    refuse_outside,
    with_seat,
)
from device.identification.output_error import Estimate, Fit, fit, require
from device.identification.recording import IdentificationError, Recording
from device.units import FloatArray

WIDEST = {
    "resistance_ohm": 0.05,
    "inductance_h": 0.3,
    "f0_hz": 0.03,
    "q_mechanical": 0.3,
    "q_electrical": 0.3,
}
"""Half an interval of 95 %, as a share, beyond which nothing is called identified."""
_ADVICE = (
    "its rise at the resonance is small against the noise: raise the level a little, make the "
    "sweep longer, or measure the acceleration"
)


@dataclass(frozen=True)
class Impedance:
    """What current for voltage at the coil says. resistance_ohm: Re; inductance_h: Le; f0_hz and
    q_mechanical: with the coil open; q_electrical: at the coil itself, without a source.

    motional_ohm_rad_s: Bl^2 / m, which becomes Bl where m is known. on_seat: see `Mode`; f0 and m
    are then those of the actuator on it. fit: for what follows from several.
    """

    resistance_ohm: Estimate
    inductance_h: Estimate
    f0_hz: Estimate
    q_mechanical: Estimate
    q_electrical: Estimate
    motional_ohm_rad_s: Estimate
    on_seat: bool
    fit: Fit


MOTIONAL = {4: 1.0, 2: 1.0, 3: -1.0}
"""Bl^2 / m = Res w0 / Qms, as powers of the fit's parameters; tau makes w0 of f0."""


def identify_impedance(recording: Recording, *, level_of_x_max: float = 0.0) -> Impedance:
    """The electrical side that a recording of current for the coil's voltage shows.

    level_of_x_max: how far the sweep moved; the intervals of f0 and Q go down by what that shifts.

    Raises
    ------
    IdentificationError
        As `identify_mode`: there is no number then.
    """
    recording.check()
    starts = _starts(recording)
    simple = fit(recording, responses.admittance, starts)
    found, on_seat = with_seat(recording, responses.admittance, simple, simple.logs[2])
    refuse_outside(recording, found.logs[2])
    if found.misfit > MOST_MISFIT:
        raise IdentificationError(
            f"the fit leaves {100 * found.misfit:.0f} % of the current unexplained, at most "
            f"{100 * MOST_MISFIT:.0f} % is allowed: this is no coil with one resonance; check what "
            "is connected, and that voltage and current are not swapped"
        )
    powers = {
        "resistance_ohm": {0: 1.0},
        "inductance_h": {1: 1.0},
        "f0_hz": {2: 1.0},
        "q_mechanical": {3: 1.0},
        "q_electrical": {3: 1.0, 0: 1.0, 4: -1.0},
    }
    values = {name: found.estimate(power) for name, power in powers.items()}
    for name, value in values.items():
        require(name, value, WIDEST[name], _ADVICE)
    square = bent_square(level_of_x_max, on_seat)
    values["f0_hz"] = values["f0_hz"].lowered(F0_BY_LEVEL * square)
    for name in ("q_mechanical", "q_electrical"):
        values[name] = values[name].lowered(Q_BY_LEVEL * square)
    motional = found.estimate(MOTIONAL, math.tau)
    return Impedance(**values, motional_ohm_rad_s=motional, on_seat=on_seat, fit=found)


def _starts(recording: Recording) -> list[FloatArray]:
    """A grid of f0 and Qms; the rest is linear in the voltage for the current, so it follows."""
    sweep, band = recording.sweep, recording.band
    f = recording.frequencies_hz[band]
    drive, current = recording.reference_spectrum[band], recording.response_spectrum[band]
    starts = []
    for hz, q in itertools.product(
        np.geomspace(sweep.low_hz, sweep.high_hz, 32), (1.0, 3.0, 10.0, 30.0)
    ):
        damped = 1j * f / (hz * q)
        shape = damped / responses.pair(f, math.log(hz), math.log(q))[0]
        columns = np.column_stack([np.ones_like(shape), 1j * math.tau * f, shape])
        volts = columns * current[:, None]
        both = np.concatenate([volts.real, volts.imag])
        scale = np.linalg.norm(both, axis=0)
        solved = np.linalg.lstsq(both / scale, np.concatenate([drive.real, drive.imag]))[0] / scale
        re = max(solved[0], 1e-3)
        le, rise = max(solved[1], 1e-6 * re), max(solved[2], 1e-3 * re)
        starts.append(np.log([re, le, hz, q, rise]))
    return starts

"""The electrical side of a rig from its impedance: Re, Le, f0, Qms, Qes, with intervals."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from device.identification import responses
from device.identification.acceleration import (
    F0_BY_LEVEL,
    Q_BY_LEVEL,
    excursion_square,
    fit_seat,
    refuse_outside,
)
from device.identification.output_error import Estimate, Fit, check_misfit, fit, require
from device.identification.recording import Recording
from device.identification.transfer import check_recording
from device.units import FloatArray

WIDEST = {
    "resistance_ohm": 0.05,
    "inductance_h": 0.3,
    "f0_hz": 0.03,
    "q_mechanical": 0.3,
    "q_electrical": 0.3,
}
"""Half the widest accepted 95 % interval, as a share."""
_ADVICE = (
    "its rise at the resonance is small against the noise: raise the level a little, make the "
    "sweep longer, or measure the acceleration"
)


@dataclass(frozen=True)
class Impedance:
    """What current for voltage at the coil shows; on a seat, f0 and m are those on it."""

    resistance_ohm: Estimate
    inductance_h: Estimate
    f0_hz: Estimate  # with the coil open
    q_mechanical: Estimate
    q_electrical: Estimate  # at the coil itself, without a source
    motional_ohm_rad_s: Estimate  # Bl^2 / m
    on_seat: bool  # see `Mode`
    fit: Fit


MOTIONAL = {4: 1.0, 2: 1.0, 3: -1.0}
"""Bl^2 / m = Res w0 / Qms as powers of the fit's parameters, times tau because w0 = tau f0."""


def identify_impedance(recording: Recording, *, level_of_x_max: float = 0.0) -> Impedance:
    """Return the electrical side from a recording of current for the coil's voltage.

    The intervals of f0 and Q are extended down by the shift at level_of_x_max.
    """
    check_recording(recording)
    simple = fit(recording, responses.admittance, _starts(recording))
    found, on_seat = fit_seat(recording, responses.admittance, simple, simple.logs[2])
    refuse_outside(recording, found.logs[2])
    check_misfit(
        found,
        "current",
        "this is not a coil with one resonance; check what is connected, and that voltage and "
        "current are not swapped",
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
    square = excursion_square(level_of_x_max, on_seat)
    values["f0_hz"] = values["f0_hz"].extend_down(F0_BY_LEVEL * square)
    for name in ("q_mechanical", "q_electrical"):
        values[name] = values[name].extend_down(Q_BY_LEVEL * square)
    motional = found.estimate(MOTIONAL, math.tau)
    return Impedance(**values, motional_ohm_rad_s=motional, on_seat=on_seat, fit=found)


def _starts(recording: Recording) -> list[FloatArray]:
    """Return a grid of f0 and Qms; the other parameters follow by linear least squares."""
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

"""Identifies parameters of actuator and amplifier from voltage and current, with 95 % intervals.

Actuator: Re, inductance, f0, Qms, Qes, Bl^2 / m. Amplifier: gain, high-pass, source impedance.
"""

import itertools
import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from device.identification import acceleration, responses
from device.identification.output_error import (
    NOTHING,
    Estimate,
    Extra,
    Fit,
    Known,
    check_fit,
    fit,
    fit_with_extras,
    penalty,
    require,
    unlimited,
)
from device.identification.recording import ComplexArray, IdentificationError, Recording
from device.identification.responses import CoilLaw, closest_parallel
from device.identification.transfer import check_recording
from device.rig.rig import Rig
from device.units import FloatArray

# Largest accepted half-width of a 95 % interval, relative to the value.
WIDEST = {"resistance_ohm": 0.05, "f0_hz": 0.03, "q_mechanical": 0.3, "q_electrical": 0.3}
COIL_OHM = 0.3, 150.0  # range of plausible coil resistances
_ADVICE = (
    "its rise at the resonance is small against the noise: raise the level a little, make the "
    "sweep longer, or measure the acceleration"
)


@dataclass(frozen=True)
class Impedance:
    """The actuator's electrical parameters; on a seat, f0 includes the seat."""

    resistance_ohm: Estimate
    f0_hz: Estimate  # with the coil open
    q_mechanical: Estimate
    q_electrical: Estimate  # of the coil itself, without a source impedance
    on_seat: bool  # as in `Mode`
    law: CoilLaw
    fit: Fit

    def admittance(self, frequencies_hz: FloatArray) -> ComplexArray:
        """Return current per voltage, (bins,), of the fitted model."""
        return responses.admittance(frequencies_hz, self.fit.logs, self.law)[0]

    def inductances(self, low_hz: float, high_hz: float) -> dict[str, Estimate]:
        """Return L of PLAIN, else L1, L2 and R2 of PARALLEL, by the names of the rig's parameters.

        Other laws are approximated by PARALLEL between low_hz and high_hz.
        """
        first, last = 4, 4 + self.law.parameters
        if self.law is responses.PLAIN:
            return {"inductance_h": self.fit.estimate({first: 1.0})}
        logs, covariance = self.fit.logs[first:last], self.fit.covariance[first:last, first:last]
        if self.law is not responses.PARALLEL:
            logs, covariance = closest_parallel(self.law, logs, covariance, low_hz, high_hz)
        found = replace(self.fit, logs=logs, covariance=covariance)
        return {
            "inductance_h": found.estimate({0: 1.0}),
            "inductance_eddy_h": found.estimate({1: 1.0}),
            "resistance_eddy_ohm": found.estimate({1: 1.0, 2: 1.0}, math.tau),
        }


# Powers in Bl^2 / m = Res w0 / Qms, by index in `Fit.logs`. w0 = tau f0 adds the factor tau.
MOTIONAL = {3: 1.0, 1: 1.0, 2: -1.0}


def identify_impedance(
    recording: Recording, *, level_of_x_max: float = 0.0, mode: acceleration.Mode | None = None
) -> Impedance:
    """Return the electrical parameters. recording: the coil's voltage (reference) and current.

    level_of_x_max: largest excursion relative to Xmax. f0 and Q rise with it, so their intervals
    are extended down. mode: resonance in acceleration per current; None if not measured.
    """
    check_recording(recording)
    found, law, on_seat = _choose(recording, mode, level_of_x_max)
    advice = (
        "this is not a coil with one resonance; check the connections, and that voltage and "
        "current are not swapped"
    )
    check_fit(recording, found, advice)
    ohm = math.exp(found.logs[0])
    if not COIL_OHM[0] <= ohm <= COIL_OHM[1]:
        raise IdentificationError(
            f"resistance_ohm={ohm:.3g} is not that of a coil that moves a cushion, "
            f"{COIL_OHM[0]:g} to {COIL_OHM[1]:g} ohm is allowed: the scale of current or voltage "
            "is wrong; measure the shunt and the divider, and correct --shunt-ohm and "
            "--voltage-ratio"
        )
    powers = {
        "resistance_ohm": {0: 1.0},
        "f0_hz": {1: 1.0},
        "q_mechanical": {2: 1.0},
        "q_electrical": {2: 1.0, 0: 1.0, 3: -1.0},
    }
    values = {name: found.estimate(power) for name, power in powers.items()}
    for name, value in values.items():
        require(name, value, WIDEST[name], _ADVICE)
    square = acceleration.excursion_square(level_of_x_max, on_seat)
    values["f0_hz"] = values["f0_hz"].extend_down(acceleration.F0_BY_LEVEL * square)
    for name in ("q_mechanical", "q_electrical"):
        values[name] = values[name].extend_down(acceleration.Q_BY_LEVEL * square)
    return Impedance(**values, on_seat=on_seat, law=law, fit=found)


# Relative standard deviations of f0 and Qms from the values in `mode`, apart from noise.
_SAME_F0, _SAME_Q = 1e-3, 5e-3
_LEAST_EDDY = 3e-4  # a law other than PLAIN must change the admittance by this share


def _choose(
    recording: Recording, mode: acceleration.Mode | None, level_of_x_max: float
) -> tuple[Fit, CoilLaw, bool]:
    """Return the best fit, its law, and whether it includes a seat."""
    tried: list[tuple[bool, float, Fit, CoilLaw, bool]] = []
    known, near = NOTHING, None
    if mode:
        near = mode.fit.logs[1:3]
        noise = np.diag(mode.fit.covariance)[1:3]
        known = Known(1, near, np.sqrt(noise + np.array([_SAME_F0, _SAME_Q]) ** 2))
    for law in responses.LAWS:
        plain_is_best = tried and min(tried, key=lambda one: one[:2])[3] is responses.PLAIN
        if plain_is_best and law in (responses.MIXED, responses.DOUBLE):
            break
        model = partial(responses.admittance, law=law)
        low, high = unlimited(4 + law.parameters)
        low[1], high[1] = np.log([0.8 * recording.sweep.low_hz, 1.2 * recording.sweep.high_hz])
        low[4:], high[4:] = np.transpose(law.limits)
        found = fit(recording, model, _starts(recording, law, near), (low, high), known)
        near = found.logs[1:3] if near is None and found.converged else near
        price = penalty(law.parameters, found.bins)
        tried.append((not found.converged, found.cost + price, found, law, False))
        seat = acceleration.seat_extra(found.logs[1], level_known=False)
        if seat and (not mode or mode.on_seat):
            starts = [np.concatenate([found.logs, start]) for start in seat.starts]
            ends = np.concatenate([low, seat.lowest]), np.concatenate([high, seat.highest])
            found = fit(recording, model, starts, ends, known)
            price += seat.doubt * penalty(seat.factor.parameters, found.bins)
            tried.append((not found.converged, found.cost + price, found, law, True))
    best = min(tried, key=lambda one: one[:2])
    plain = min((one for one in tried if one[3] is responses.PLAIN), key=lambda one: one[:2])
    f = recording.frequencies_hz[recording.band]
    least = _LEAST_EDDY + acceleration.HARDENING * level_of_x_max**2
    if not plain[0]:  # without noise, any difference between two laws would count as evidence
        shown, simple = (responses.admittance(f, one[2].logs, one[3])[0] for one in (best, plain))
        best = plain if np.abs(simple / shown - 1.0).max() < least else best
    _, _, found, law, seated = best
    return found, law, seated


def _starts(recording: Recording, law: CoilLaw, near: FloatArray | None) -> list[FloatArray]:
    """Return start values of all parameters. near: logs of f0 and Qms from another fit."""
    sweep, band = recording.sweep, recording.band
    f = recording.frequencies_hz[band]
    drive, current = recording.reference_spectrum[band], recording.response_spectrum[band]
    tones = np.log(np.geomspace(sweep.low_hz, sweep.high_hz, 32))
    qs = np.log([1.0, 3.0, 10.0, 30.0])
    if near is not None:
        tones, qs = near[:1], near[1] + np.log([0.6, 1.0, 1.6])
    starts = []
    for log_hz, log_q, shape in itertools.product(tones, qs, law.shapes):
        damped = 1j * f / math.exp(log_hz + log_q)
        motional = damped / responses.pair(f, log_hz, log_q)[0]
        columns = [np.ones_like(motional), motional, *law.columns(f, shape)]
        volts = np.column_stack(columns) * current[:, None]
        both = np.concatenate([volts.real, volts.imag])
        scale = np.linalg.norm(both, axis=0)
        solved = np.linalg.lstsq(both / scale, np.concatenate([drive.real, drive.imag]))[0] / scale
        re = max(solved[0], 1e-3)
        rise = max(solved[1], 1e-3 * re)
        amplitudes = np.maximum(solved[2:], 1e-6 * re)
        first = [math.log(re), log_hz, log_q, math.log(rise)]
        starts.append(np.concatenate([first, np.log(amplitudes), shape]))
    return starts


LEAST_SOURCE = 1e-3  # a source impedance below this share of the coil's resistance is negligible


@dataclass(frozen=True)
class Drive:
    """The amplifier's values, identified from the played signal and the coil's voltage."""

    volts: Estimate  # open-circuit peak for a sample of 1.0
    high_pass_hz: Estimate | None  # None: as in the rig
    source_ohm: Estimate | None  # None: as in the rig


def identify_drive(recording: Recording, rig: Rig, impedance: Impedance | None) -> Drive:
    """Return the amplifier's values. recording: played signal (reference) and coil voltage.

    `recording.correction` must contain the frequency response of the rig's amplifier. impedance:
    None if the current was not measured.
    """
    f = recording.frequencies_hz[recording.band][recording.usable]
    factors = [responses.GAIN, *([responses.DELAY] if recording.delayed else [])]
    extras = [acceleration.high_pass_extra(recording)]
    if impedance:
        r = impedance.resistance_ohm.value
        starts = tuple(np.log([share * r]) for share in (0.03, 0.3, 3.0, 30.0))
        ends = np.log([1e-3 * r]), np.log([1e4 * r])
        extras.append(Extra("source", responses.load(impedance.admittance(f)), starts, *ends))
    band = recording.band
    played, measured = recording.reference_spectrum[band], recording.response_spectrum[band]
    # the logarithm of the gain, and the delay in ms
    start = [math.log(float(np.linalg.norm(measured) / np.linalg.norm(played)))]
    if recording.delayed:
        in_band_hz = recording.frequencies_hz[band]
        delay_s = acceleration.find_delay_s(in_band_hz, played.conj() * measured)
        start.append(delay_s / responses.DELAY_S)
    found, chosen, _ = fit_with_extras(recording, factors, [np.array(start)], extras)
    advice = (
        "this is not an amplifier with one high-pass; switch off equalisers, and check the inputs"
    )
    check_fit(recording, found, advice, resonance=False)
    volts, source = found.estimate({0: 1.0}), None
    names = [extra.name for extra in chosen]
    if impedance and "source" in names:  # each of the extras has one parameter
        source = found.estimate({len(factors) + names.index("source"): 1.0})
        if source.value < LEAST_SOURCE * impedance.resistance_ohm.value:
            source = None
    if source is None:
        volts = volts.scaled(1.0 + rig.amplifier.source_impedance_ohm / rig.actuator.resistance_ohm)
    require("volts per full scale", volts, 0.05, "raise the level a little")
    corner = acceleration.corner_of(found, chosen, len(factors), recording.high_pass_hz or 0.0)
    return Drive(volts, corner, source)

"""Identifies a rig's resonance from its acceleration: f0, Q, sensitivity, with 95 % intervals."""

import itertools
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from device.identification import responses
from device.identification.output_error import (
    Estimate,
    Extra,
    Fit,
    check_fit,
    fit,
    fit_with_extras,
    require,
)
from device.identification.recording import ComplexArray, IdentificationError, Recording
from device.identification.responses import DELAY, EDDY, LAG, MODE, SEAT, Factor, high_pass, product
from device.identification.transfer import check_recording
from device.units import FloatArray

# Largest accepted half-width of a 95 % interval, relative to the value.
WIDEST_F0, WIDEST_Q, WIDEST_SENSITIVITY = 0.02, 0.2, 0.2

# Relative rise of f0 and Q, per (excursion / Xmax)^2; intervals are extended down by the rise.
# If stiffness is 50 % higher at Xmax, f0 rises by 3/8 of 50 % (describing function). Q rises with
# f0, and because Bl falls by a quarter.
F0_BY_LEVEL, Q_BY_LEVEL = 0.19, 0.4

# Largest relative r.m.s. change of the response by a hardening spring, per (excursion / Xmax)^2.
# A seat is accepted only if it changes the response by more.
HARDENING = 0.5
# Candidates for the remaining delay, also negative: `find_delay` can be a quarter period late.
_DELAYS_S = np.arange(-8e-3, 4e-3, 0.25e-3)
_ADVICE = "raise the level a little, make the sweep longer or bring it closer to the resonance"


@dataclass(frozen=True)
class Mode:
    """The resonance of the acceleration. Under voltage drive, q includes electrical damping."""

    f0_hz: Estimate
    q: Estimate
    sensitivity: Estimate  # m/s^2 per V or A above the resonance; Bl / m relative to current
    on_seat: bool  # whether the fit includes a moving frame; then f0 and Q include the seat
    level_of_x_max: float  # largest excursion of the moving mass relative to the ground, over Xmax
    fit: Fit
    inverted: bool = False  # whether the accelerometer has the opposite sign
    high_pass_hz: Estimate | None = None  # the amplifier's corner, if it differs from the rig's


def identify_mode(recording: Recording, x_max_m: float, *, on_seat: bool | None = None) -> Mode:
    """Return the resonance in acceleration per current or voltage. on_seat: None if unknown."""
    check_recording(recording)
    mode, shown = _identify(recording, x_max_m, on_seat)
    if mode.on_seat and on_seat is None:
        with suppress(IdentificationError):
            simple, without = _identify(recording, x_max_m, False)
            change = float(np.sqrt(np.mean(np.abs(without / shown - 1.0) ** 2)))
            if change < HARDENING * mode.level_of_x_max**2:
                return replace(simple, f0_hz=simple.f0_hz.join(mode.f0_hz))
    return mode


def _identify(
    recording: Recording, x_max_m: float, on_seat: bool | None
) -> tuple[Mode, ComplexArray]:
    """Return the resonance, and the fitted frequency response in the band."""
    electrical = recording.names[0] != "current"
    factors = [MODE, *([LAG] if electrical else []), *([DELAY] if recording.delayed else [])]
    level_known = math.isfinite(x_max_m)
    recording, found, extras, inverted = _fit_mode(recording, factors, on_seat, level_known)
    on_seat = any(extra.name == "seat" for extra in extras)
    advice = (
        "the band has several resonances and a seat, or this is another channel; check the "
        "input, fasten loose parts, or sweep a narrower band"
    )
    check_fit(recording, found, advice)
    sensitivity, f0, q = (found.estimate({index: 1.0}) for index in range(3))
    require("sensitivity", sensitivity, WIDEST_SENSITIVITY, _ADVICE)
    require("f0_hz", f0, WIDEST_F0, _ADVICE)
    require("q", q, WIDEST_Q, _ADVICE)
    model = product(*factors, *(extra.factor for extra in extras))
    shown = model(recording.frequencies_hz[recording.band], found.logs)[0]
    # Clock drift turns the phase by this angle, and so shifts f0 by the share angle / (2 Q).
    turned = math.tau * f0.value * recording.drift_reach * recording.sweep.duration_s
    f0 = f0.widen(0.5 * turned / q.value)
    share = recording.excursion_m(shown) / x_max_m
    square = excursion_square(share, on_seat)
    f0, q = f0.extend_down(F0_BY_LEVEL * square), q.extend_down(Q_BY_LEVEL * square)
    first = sum(factor.parameters for factor in factors)
    corner = corner_of(found, extras, first, recording.high_pass_hz or 0.0)
    return Mode(f0, q, sensitivity, on_seat, share, found, inverted, corner), shown


def _fit_mode(
    recording: Recording, factors: list[Factor], on_seat: bool | None, level_known: bool
) -> tuple[Recording, Fit, tuple[Extra, ...], bool]:
    """Return the recording of the likelier sign, its fit and extras, and whether it is inverted."""
    candidates = [recording]
    if not recording.polarity_known:
        candidates.append(replace(recording, response=-recording.response))
    found = []
    for candidate in candidates:
        simple = fit(candidate, product(*factors), _starts(candidate, factors))
        extras = [_eddy()] if LAG in factors else []
        if recording.high_pass_hz is not None:
            extras.append(high_pass_extra(recording))
        if on_seat is not False and (seat := seat_extra(simple.logs[1], level_known=level_known)):
            extras.append(seat)
        best, chosen, score = fit_with_extras(
            candidate, factors, [simple.logs], extras, _is_identified
        )
        found.append((not best.converged, score, candidate, best, chosen))
    _, _, candidate, best, chosen = min(found, key=lambda one: one[:2])
    return candidate, best, chosen, candidate is not recording


def _is_identified(found: Fit) -> bool:
    """Return whether the intervals of sensitivity, f0 and Q are narrow enough."""
    widest = (WIDEST_SENSITIVITY, WIDEST_F0, WIDEST_Q)
    return all(found.estimate({i: 1.0}).relative <= most for i, most in enumerate(widest))


def _eddy() -> Extra:
    """Return a factor for the effect of eddy currents on the coil's lag under voltage drive."""
    corners = np.log([60.0, 200.0, 600.0])
    starts = tuple(-math.log(math.tau) - np.array([hz, hz - 0.2]) for hz in corners)
    lowest, highest = (np.full(2, -math.log(math.tau * hz)) for hz in (10e3, 5.0))
    return Extra("eddy", EDDY, starts, lowest, highest)


def high_pass_extra(recording: Recording) -> Extra:
    """Return a factor for an amplifier whose high-pass deviates from the rig's."""
    known, low = recording.high_pass_hz or 0.0, recording.sweep.low_hz
    starts = tuple(np.log([hz]) for hz in (0.3 * low, 0.7 * low, 0.1 * low, 1.5 * low))
    limits = np.log([LOWEST_CORNER * low]), np.log([4.0 * low])
    return Extra("high_pass", high_pass(known), starts, *limits)


_SAME_CORNER = 0.01
LOWEST_CORNER = 0.02  # relative to the sweep's lowest frequency; a lower corner is negligible


def corner_of(found: Fit, extras: Sequence[Extra], first: int, known_hz: float) -> Estimate | None:
    """Return the fitted high-pass corner in Hz: 0 if negligible, None if absent or near known_hz.

    first: index in `found.logs` of the first parameter of `extras`.
    """
    for extra in extras:
        if extra.name == "high_pass":
            corner = found.estimate({first: 1.0})
            if abs(corner.value - known_hz) < _SAME_CORNER * known_hz:
                return None
            if found.logs[first] > extra.lowest[0] + 0.1 and corner.low > 0.5 * corner.value:
                return corner
            return Estimate(0.0, 0.0, corner.high if corner.high < math.inf else corner.value)
        first += extra.factor.parameters
    return None


def excursion_square(level_of_x_max: float, on_seat: bool) -> float:
    """Return an upper bound on the square of (excursion of the spring / Xmax)."""
    # On a seat the frame moves. The factor 2 suffices if the frame weighs over 2.4 moving masses.
    return level_of_x_max**2 * (2.0 if on_seat else 1.0)


def seat_extra(log_hz: float, *, level_known: bool) -> Extra | None:
    """Return the seat's factor for an actuator's log f0; None if no seat resonance fits below f0.

    A hardening spring has a similar effect: a seat needs more evidence if the level is unknown.
    """
    own = log_hz - math.log(4.0)
    highest = np.array([log_hz - math.log(1.5), math.log(5.0)] * 2)
    lowest = np.array([math.log(2.0), math.log(0.2)] * 2)
    if np.any(highest < lowest + 0.5):
        return None
    starts = tuple(np.array([own + shift, 0.0] * 2) for shift in (0.0, 0.5))
    return Extra("seat", SEAT, starts, lowest, highest, doubt=1.0 if level_known else 2.5)


def _starts(recording: Recording, factors: Sequence[Factor]) -> list[FloatArray]:
    """Return start values: a grid of f0 in the band and Q of 1 to 30, each with a sensitivity."""
    sweep, band = recording.sweep, recording.band
    f = recording.frequencies_hz[band]
    drive, measured = recording.reference_spectrum[band], recording.response_spectrum[band]
    lags = [-8.0] if LAG in factors else []
    model = product(*(factor for factor in factors if factor is not DELAY))
    starts = []
    for hz, q in itertools.product(
        np.geomspace(sweep.low_hz, sweep.high_hz, 24), (1.0, 3.0, 10.0, 30.0)
    ):
        p = np.array([0.0, math.log(hz), math.log(q), *lags])
        explained = model(f, p)[0] * drive
        agreement, late = np.vdot(explained, measured), []
        if DELAY in factors:
            turned = explained.conj() * measured
            delay_s = find_delay_s(f, turned)
            agreement = np.sum(turned * np.exp(1j * math.tau * f * delay_s))
            late = [delay_s / responses.DELAY_S]
        scale = float(np.abs(agreement) / np.vdot(explained, explained).real)
        starts.append(np.array([math.log(max(scale, 1e-10)), *p[1:], *late]))
    return starts


def find_delay_s(f: FloatArray, turned: ComplexArray) -> float:
    """Return the delay in s whose removal maximises the real part of a cross-spectrum's sum."""
    agreements = [np.sum(turned * np.exp(1j * math.tau * f * s)).real for s in _DELAYS_S]
    return float(_DELAYS_S[int(np.argmax(agreements))])

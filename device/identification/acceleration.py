"""The mode of a rig from its acceleration: f0, Q and sensitivity, with intervals."""

import itertools
import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from device.identification import responses
from device.identification.output_error import (
    Estimate,
    Fit,
    Model,
    check_misfit,
    fit,
    is_better,
    require,
)
from device.identification.recording import IdentificationError, Recording
from device.identification.transfer import check_recording
from device.units import FloatArray

WIDEST_F0, WIDEST_Q, WIDEST_SENSITIVITY = 0.02, 0.2, 0.2
"""Half the widest accepted 95 % interval, as a share."""

F0_BY_LEVEL, Q_BY_LEVEL = 0.19, 0.4
"""Shares by which f0 and Q rise, per square of the level in Xmax. If stiffness is 50 % higher at
Xmax, f0 rises by 3/8 of that (describing function). Q rises with it, and because Bl falls by a
quarter. Intervals are extended down by this much, because they are for the rig at rest."""
_DELAYS_S = np.arange(-8e-3, 4e-3, 0.25e-3)
"""Starts for an unknown delay. It was measured at the peak of the impulse response, up to a quarter
of a period after its beginning."""
_ADVICE = "raise the level a little, make the sweep longer or bring it closer to the resonance"


@dataclass(frozen=True)
class Mode:
    """The mode that an acceleration sweep shows.

    Against current, f0 and Q are the mechanical ones (f0, Qms). Against voltage, they are those of
    the poles under that drive, including the electrical damping.
    """

    f0_hz: Estimate
    q: Estimate
    sensitivity: Estimate  # m/s^2 per V or A above the resonance; Bl / m against current
    on_seat: bool  # the response needs a moving frame; f0 and Q are those on it
    level_of_x_max: float  # largest excursion of the moving mass, without the frame's
    fit: Fit
    inverted: bool = False  # the accelerometer has the other sign


def identify_mode(recording: Recording, x_max_m: float, *, widest: float = 1.0) -> Mode:
    """Return the mode that a recording of acceleration, for a current or a voltage, shows.

    x_max_m gives the level; `widest` is a factor on the widest accepted intervals.
    """
    check_recording(recording)
    electrical = recording.names[0] != "current"
    recording, found, on_seat, inverted = _fit_mode(recording, electrical)
    refuse_outside(recording, found.logs[1])
    check_misfit(
        found,
        "acceleration",
        "more than one resonance and a seat are in the band, or this is another channel; check "
        "which input it is, fasten what rattles, or sweep a narrower band around the resonance",
    )
    values = [found.estimate({index: 1.0}) for index in range(3)]
    limits = ("sensitivity", WIDEST_SENSITIVITY), ("f0_hz", WIDEST_F0), ("q", WIDEST_Q)
    for (name, limit), value in zip(limits, values, strict=True):
        require(name, value, limit * widest, _ADVICE)
    f = recording.frequencies_hz[recording.band]
    moved = recording.excursion_m(_model(recording, electrical)(f, found.logs)[0])
    sensitivity, f0, q = values
    # Clock drift turns the phase by this angle, which at f0 shifts it by angle / (2 Q).
    turned = math.tau * f0.value * recording.drift_reach * recording.sweep.duration_s
    f0 = f0.widen(0.5 * turned / q.value)
    share = moved / x_max_m
    square = excursion_square(share, on_seat)
    f0, q = f0.extend_down(F0_BY_LEVEL * square), q.extend_down(Q_BY_LEVEL * square)
    return Mode(f0, q, sensitivity, on_seat, share, found, inverted)


def _model(recording: Recording, electrical: bool) -> Model:
    if recording.delayed:
        return responses.delayed_acceleration
    return partial(responses.acceleration, electrical=electrical)


def _fit_mode(recording: Recording, electrical: bool) -> tuple[Recording, Fit, bool, bool]:
    """Return recording, fit, whether it needs a seat, and whether the polarity is inverted.

    The simple fit is used unless one with a seat, or the other unknown polarity, explains more.
    """
    candidates = [recording]
    if not recording.polarity_known:
        candidates.append(replace(recording, response=-recording.response))
    model = _model(recording, electrical)
    found: list[tuple[Recording, Fit]] = []
    errors: list[IdentificationError] = []
    for candidate in candidates:
        try:
            found.append((candidate, fit(candidate, model, _starts(candidate, electrical))))
        except IdentificationError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    chosen, simple = min(found, key=lambda one: one[1].cost)
    best, on_seat = fit_seat(chosen, model, simple, simple.logs[1])
    return chosen, best, on_seat, chosen is not recording


def excursion_square(level_of_x_max: float, on_seat: bool) -> float:
    """Return the largest square of the spring's excursion in Xmax.

    On a seat the frame also moves, by m / M, which the mass alone does not show. Twice the square
    covers any frame of at least 2.4 times the moving mass.
    """
    return level_of_x_max**2 * (2.0 if on_seat else 1.0)


def fit_seat(recording: Recording, model: Model, simple: Fit, log_hz: float) -> tuple[Fit, bool]:
    """Return the simple fit or, if it explains more, one with a seat; and which it is.

    A seat's own mode must be damped and lie below that of the actuator, log_hz.
    """
    own = log_hz - math.log(4.0)
    highest = np.array([log_hz - math.log(1.5), math.log(5.0)] * 2)
    lowest = np.array([math.log(2.0), math.log(0.2)] * 2)
    if np.any(highest < lowest + 0.5):
        return simple, False  # no seat fits below such a mode
    far = np.full(len(simple.logs), 25.0)
    limits = np.concatenate([-far, lowest]), np.concatenate([far, highest])
    seats = [
        np.concatenate([simple.logs, [own + shift, 0.0, own + shift, 0.0]]) for shift in (0.0, 0.5)
    ]
    try:
        richer = fit(recording, model, seats, limits)
    except IdentificationError:
        return simple, False
    return (richer, True) if is_better(simple, richer) else (simple, False)


def _starts(recording: Recording, electrical: bool) -> list[FloatArray]:
    """Return a grid over the band and usual Q, each with its best sensitivity."""
    sweep, band = recording.sweep, recording.band
    f = recording.frequencies_hz[band]
    drive, measured = recording.reference_spectrum[band], recording.response_spectrum[band]
    lags = [-8.0] if electrical else []
    starts = []
    for hz, q in itertools.product(
        np.geomspace(sweep.low_hz, sweep.high_hz, 24), (1.0, 3.0, 10.0, 30.0)
    ):
        p = np.array([0.0, math.log(hz), math.log(q), *lags])
        explained = responses.acceleration(f, p, electrical=electrical)[0] * drive
        agreement, late = np.vdot(explained, measured), []
        if recording.delayed:
            turned = explained.conj() * measured
            agreements = [np.sum(turned * np.exp(1j * math.tau * f * s)) for s in _DELAYS_S]
            best = int(np.argmax(np.real(agreements)))
            agreement, late = agreements[best], [_DELAYS_S[best] / responses.DELAY_S]
        scale = float(np.abs(agreement) / np.vdot(explained, explained).real)
        starts.append(np.array([math.log(max(scale, 1e-10)), *p[1:], *late]))
    return starts


def refuse_outside(recording: Recording, log_hz: float) -> None:
    """Refuse a resonance, by log f0, outside the sweep or too close to its ends."""
    sweep = recording.sweep
    low, high = 1.1 * sweep.low_hz, 0.9 * sweep.high_hz
    if log_hz <= math.log(low) or log_hz >= math.log(high):
        end, to = ("lower", "start lower") if log_hz <= math.log(low) else ("upper", "go higher")
        raise IdentificationError(
            f"the resonance is outside the band, {low:.4g} to {high:.4g} Hz of a sweep from "
            f"{sweep.low_hz:.4g} to {sweep.high_hz:.4g} Hz: it is beyond the {end} end; {to}, or "
            "check which input it is"
        )

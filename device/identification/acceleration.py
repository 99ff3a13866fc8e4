"""The mode of a rig from its acceleration: f0, Q and sensitivity, with intervals."""

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.fft import irfft

from device.identification import responses
from device.identification.output_error import Estimate, Fit, Model, better, fit, require
from device.identification.recording import IdentificationError, Recording
from device.units import FloatArray

Drive = Literal["voltage", "current"]

WIDEST_F0, WIDEST_Q, WIDEST_SENSITIVITY = 0.02, 0.2, 0.2
"""Half an interval of 95 %, as a share, beyond which nothing is called identified."""
MOST_MISFIT = 0.1

F0_BY_LEVEL, Q_BY_LEVEL = 0.19, 0.4
"""Shares by which f0 and Q rise, times the square of the level in Xmax. A spring that is half as
stiff again at Xmax raises f0 by 3/8 of that half while it moves so far (describing function); Q
rises with it, and as a quarter of Bl is lost at Xmax. The intervals go down by so much: they are
of the rig at rest, and noise is not all that a sweep of some level is wrong by."""
_DELAYS_S = np.arange(-8e-3, 4e-3, 0.25e-3)
"""Of starts, where it is not known: it was measured at the peak of the impulse response, which
comes later than its beginning by up to a quarter of a period."""
_ADVICE = "raise the level a little, make the sweep longer or bring it closer to the resonance"


@dataclass(frozen=True)
class Mode:
    """What an acceleration sweep says.

    f0_hz, q: of the mode. Against current they are the mechanical ones, f0 and Qms; against
    voltage those of the poles under that drive, with the electrical damping in them.
    sensitivity: m/s^2 per V or A, well above the resonance; Bl / m against current.
    on_seat: a frame that gives way was needed to explain the response: f0_hz and q are those of
    the actuator on it. level_of_x_max: the largest excursion of the moving mass in the sweep, as
    a share of Xmax; the frame's, which goes against it, is not in it. fit: for what follows from
    several. inverted: the accelerometer shows the other sign, where that was not known.
    """

    drive: Drive
    f0_hz: Estimate
    q: Estimate
    sensitivity: Estimate
    on_seat: bool
    level_of_x_max: float
    fit: Fit
    inverted: bool = False


def identify_mode(
    recording: Recording, x_max_m: float, drive: Drive = "voltage", *, widest: float = 1.0
) -> Mode:
    """The mode that a recording of acceleration shows; x_max_m: to state the level.

    widest: factor on the widest intervals that are accepted.

    Raises
    ------
    IdentificationError
        No signal, clipping, the wrong channel; a resonance outside the band; a fit that does not
        converge or does not fit; a value that is not identified. Then there is no number.
    """
    recording.check()
    electrical = drive == "voltage"
    recording, found, on_seat, inverted = _fitted(recording, electrical)
    refuse_outside(recording, found.logs[1])
    if found.misfit > MOST_MISFIT:
        raise IdentificationError(
            f"the fit leaves {100 * found.misfit:.0f} % of the acceleration unexplained, at most "
            f"{100 * MOST_MISFIT:.0f} % is allowed: more than one resonance and a seat are in the "
            "band, or this is another channel; check which input it is, fasten what rattles, or "
            "sweep a narrower band around the resonance"
        )
    values = [found.estimate({index: 1.0}) for index in range(3)]
    limits = ("sensitivity", WIDEST_SENSITIVITY), ("f0_hz", WIDEST_F0), ("q", WIDEST_Q)
    for (name, limit), value in zip(limits, values, strict=True):
        require(name, value, limit * widest, _ADVICE)
    moved = _excursion_m(recording, found, electrical)
    sensitivity, f0, q = values
    # a clock that is off turns the phase there by so much, and at f0 that falls by 2 Q a share of f
    turned = math.tau * f0.value * recording.drift_reach * recording.sweep.duration_s
    f0 = f0.widened(0.5 * turned / q.value)
    share = moved / x_max_m
    square = bent_square(share, on_seat)
    f0, q = f0.lowered(F0_BY_LEVEL * square), q.lowered(Q_BY_LEVEL * square)
    return Mode(drive, f0, q, sensitivity, on_seat, share, found, inverted)


def _model(recording: Recording, electrical: bool) -> Model:
    if recording.delayed:
        return responses.delayed_acceleration

    def model(f: FloatArray, p: FloatArray) -> responses.Response:
        return responses.acceleration(f, p, electrical=electrical)

    return model


def _fitted(recording: Recording, electrical: bool) -> tuple[Recording, Fit, bool, bool]:
    """The plain fit, or the one with a seat, where that explains more; with its recording.

    Where the polarity is not known, the one that explains more; whether that is upside down.
    """
    ways = [recording] if recording.polarity_known else [recording, recording.inverted()]
    model = _model(recording, electrical)
    found: list[tuple[Recording, Fit]] = []
    errors: list[IdentificationError] = []
    for way in ways:
        try:
            found.append((way, fit(way, model, _starts(way, electrical))))
        except IdentificationError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    way, simple = min(found, key=lambda one: one[1].cost)
    best, on_seat = with_seat(way, model, simple, simple.logs[1])
    return way, best, on_seat, way is not recording


def bent_square(level_of_x_max: float, on_seat: bool) -> float:
    """Square of how far the spring was bent, in Xmax, at most.

    On a seat the frame moves against the mass, by m / M of it, which the mass alone does not tell;
    twice the square is enough for any frame from 2.4 times the moving mass on.
    """
    return level_of_x_max**2 * (2.0 if on_seat else 1.0)


def with_seat(recording: Recording, model: Model, simple: Fit, log_hz: float) -> tuple[Fit, bool]:
    """The simple fit, or one with a seat, and whether: if that explains more, and is one.

    A seat's own mode lies below that of the actuator, log_hz, and is damped; what is not like
    that is not in the model.
    """
    own = log_hz - math.log(4.0)
    highest = np.array([log_hz - math.log(1.5), math.log(5.0)] * 2)
    lowest = np.array([math.log(2.0), math.log(0.2)] * 2)
    if np.any(highest < lowest + 0.5):
        return simple, False  # there is no room for a seat below such a mode
    far = np.full(len(simple.logs), 25.0)
    limits = np.concatenate([-far, lowest]), np.concatenate([far, highest])
    seats = [
        np.concatenate([simple.logs, [own + shift, 0.0, own + shift, 0.0]]) for shift in (0.0, 0.5)
    ]
    try:
        richer = fit(recording, model, seats, limits)
    except IdentificationError:
        return simple, False
    return (richer, True) if better(simple, richer) else (simple, False)


def _starts(recording: Recording, electrical: bool) -> list[FloatArray]:
    """A grid over the band and usual Q; the sensitivity that suits each follows from it."""
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
    """Refuse a resonance that the sweep has not passed; log_hz: of its f0.

    Raises
    ------
    IdentificationError
        It is below, above, or so close to an end that the ends decide.
    """
    sweep = recording.sweep
    low, high = 1.1 * sweep.low_hz, 0.9 * sweep.high_hz
    if log_hz <= math.log(low) or log_hz >= math.log(high):
        end, to = ("lower", "start lower") if log_hz <= math.log(low) else ("upper", "go higher")
        raise IdentificationError(
            f"the resonance is outside the band, {low:.4g} to {high:.4g} Hz of a sweep from "
            f"{sweep.low_hz:.4g} to {sweep.high_hz:.4g} Hz: it is beyond the {end} end; {to}, or "
            "check which input it is"
        )


def _excursion_m(recording: Recording, found: Fit, electrical: bool) -> float:
    """Peak excursion of the moving mass by the model, m: two integrations of its acceleration."""
    band = recording.band
    f = recording.frequencies_hz[band]
    spectrum = np.zeros(len(recording.frequencies_hz), complex)
    h = _model(recording, electrical)(f, found.logs)[0]
    spectrum[band] = h * recording.reference_spectrum[band] / -((math.tau * f) ** 2)
    return float(np.abs(irfft(spectrum, recording.length)).max())

"""Output-error fits: minimise the difference between the response and its model.

If only the response is noisy, weighting by the inverse noise spectrum gives the maximum-likelihood
estimate (Ljung, "System Identification", 2nd ed. 1999, chapter 7). A recording begins and ends with
silence, so its frequency bins are treated as independent.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from device.identification.recording import ComplexArray, IdentificationError, Recording, box_mean
from device.identification.responses import Factor, Response, product
from device.units import FloatArray

Model = Callable[[FloatArray, FloatArray], Response]

MOST_MISFIT = 0.1
_NORMAL_95 = 1.959964
_ROUGH, _FINE = 1e-6, 1e-10  # tolerances of all fits but the last, and of the last
_WEIGHTINGS = 4  # number of repeated fits, each with the noise spectrum of the previous fit
_SMOOTH_BINS = 101
_LEFT_OUT = 1e-4  # standard deviation that resampling and converters add to each parameter
_FAR = 25.0  # largest magnitude of a logarithm; it keeps exponentials finite


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval, in the same unit."""

    value: float
    low: float
    high: float

    @property
    def relative(self) -> float:
        """Half the width of the interval, relative to the value."""
        return 0.5 * (self.high - self.low) / abs(self.value) if self.value else math.inf

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the interval."""
        return self.low, self.high

    def scaled(self, factor: float) -> "Estimate":
        """Return the estimate times a factor."""
        return Estimate(factor * self.value, factor * self.low, factor * self.high)

    def extend_down(self, share: float) -> "Estimate":
        """Return the estimate with its interval extended downwards by a share of the value."""
        return Estimate(self.value, self.low - share * self.value, self.high)

    def join(self, other: "Estimate") -> "Estimate":
        """Return the middle of both intervals, if it is unknown which of the estimates is right."""
        low, high = min(self.low, other.low), max(self.high, other.high)
        return Estimate(0.5 * (low + high), low, high)

    def widen(self, share: float) -> "Estimate":
        """Return the estimate with an interval widened by an independent relative error `share`."""
        more = share * self.value
        low = self.value - math.hypot(self.value - self.low, more)
        return Estimate(self.value, low, self.value + math.hypot(self.high - self.value, more))


@dataclass(frozen=True)
class Fit:
    """The parameters of a fitted response."""

    logs: FloatArray  # parameters as in `responses`: logarithms or delays, (parameters,)
    covariance: FloatArray  # of `logs`
    misfit: float  # r.m.s. of the residual beyond noise, relative to the response's r.m.s.
    cost: float  # negative log-likelihood
    bins: int
    converged: bool = True

    def estimate(self, weights: dict[int, float], factor: float = 1.0) -> Estimate:
        """Return factor times a product of powers of parameters. weights: {index: power}."""
        return multiply_powers([(self, weights)], factor)


def multiply_powers(parts: Sequence[tuple[Fit, dict[int, float]]], factor: float = 1.0) -> Estimate:
    """Return factor times a product of powers. parts: independent fits with {index: power} each."""
    log, variance = math.log(factor), 0.0
    for fit, powers in parts:
        row = np.zeros(len(fit.logs))
        row[list(powers)] = list(powers.values())
        log += float(row @ fit.logs)
        variance += float(row @ fit.covariance @ row)
    # Powers are linear in the logarithms, so no linearisation is needed.
    reach = _NORMAL_95 * math.sqrt(variance) if variance >= 0.0 else math.inf
    if reach > 5.0:
        return Estimate(math.exp(log), 0.0, math.inf)
    return Estimate(math.exp(log), math.exp(log - reach), math.exp(log + reach))


@dataclass(frozen=True)
class Known:
    """Parameters of a model, from index `first` on, known from another measurement."""

    first: int = 0
    logs: FloatArray = field(default_factory=lambda: np.zeros(0))
    deviation: FloatArray = field(default_factory=lambda: np.zeros(0))  # of each parameter

    def misses(self, p: FloatArray) -> FloatArray:
        """Return the deviations of p from the known values, in standard deviations."""
        return (p[self.first : self.first + len(self.logs)] - self.logs) / self.deviation

    def slopes(self, parameters: int) -> FloatArray:
        """Return the derivatives of `misses`."""
        return np.eye(len(self.logs), parameters, self.first) / self.deviation[:, None]


NOTHING = Known()


def fit(
    recording: Recording,
    model: Model,
    starts: Sequence[FloatArray],
    limits: tuple[FloatArray, FloatArray] | None = None,
    known: Known = NOTHING,
) -> Fit:
    """Fit the parameters of a model to a recording that `check_recording` has accepted.

    The fit starts from the best two of `starts`. limits: lowest and highest parameters. A parameter
    that ends at a limit gets the variance 0. Only a converged fit is valid.
    """
    low, high = limits or unlimited(len(starts[0]))
    band, usable = recording.band, recording.usable
    f = recording.frequencies_hz[band][usable]
    drive = recording.reference_spectrum[band][usable]
    measured = recording.response_spectrum[band][usable]
    deviation = np.full(len(f), float(np.sqrt(np.mean(np.abs(measured) ** 2))))

    def left(p: FloatArray) -> ComplexArray:
        return np.asarray((measured - model(f, p)[0] * drive) / deviation)

    # The real and the imaginary part of a residual each have half of its variance.
    def stacked(p: FloatArray) -> FloatArray:
        e = left(p)
        return np.concatenate([e.real, e.imag, known.misses(p) / math.sqrt(2.0)])

    def measured_slopes(p: FloatArray) -> FloatArray:
        slopes = -model(f, p)[1] * (drive / deviation)[:, None]
        return np.concatenate([slopes.real, slopes.imag])

    def jacobian(p: FloatArray) -> FloatArray:
        return np.concatenate([measured_slopes(p), known.slopes(len(p)) / math.sqrt(2.0)])

    def solved(start: FloatArray, tolerance: float) -> tuple[float, FloatArray, bool]:
        inside = np.clip(start, low + 1e-6, high - 1e-6)
        ends = tolerance, tolerance, tolerance
        found = least_squares(stacked, inside, jacobian, (low, high), "trf", *ends, max_nfev=200)
        lost = bool(np.any(np.abs(found.x) > 0.99 * _FAR))
        return float(found.cost), np.asarray(found.x), bool(found.success) and not lost

    ranked = sorted(starts, key=lambda start: float(np.sum(np.abs(left(start)) ** 2)))
    _, logs, converged = min((solved(one, _ROUGH) for one in ranked[:2]), key=lambda one: one[0])
    for tolerance in (*(_WEIGHTINGS - 1) * [_ROUGH], _FINE):
        power = box_mean(np.abs(left(logs)) ** 2, min(_SMOOTH_BINS, len(f)))
        deviation = deviation * np.sqrt(np.maximum(power, 1e-12 * float(power.max()) + 1e-300))
        _, logs, converged = solved(logs, tolerance)
    e = left(logs)
    slopes = measured_slopes(logs)
    # Model errors correlate neighbouring bins; the noise of neighbouring bins is independent.
    turned = e * np.exp(-1j * np.angle(drive))
    correlation = float(np.real(np.vdot(turned[1:], turned[:-1])) / np.sum(np.abs(turned) ** 2))
    held = max(0.0, min(correlation, 0.98))
    variance = 0.5 * float(np.mean(np.abs(e) ** 2)) * (1.0 + held) / (1.0 - held)
    free = np.flatnonzero(np.minimum(logs - low, high - logs) > 1e-3)
    covariance = np.zeros((len(logs), len(logs)))
    information = slopes.T @ slopes / variance
    information += known.slopes(len(logs)).T @ known.slopes(len(logs))
    covariance[np.ix_(free, free)] = np.linalg.pinv(
        information[np.ix_(free, free)], rcond=1e-14, hermitian=True
    )
    covariance[free, free] += _LEFT_OUT**2
    whole = float(np.sum(np.abs(measured) ** 2))
    misfit = math.sqrt(held * float(np.sum(np.abs(e * deviation) ** 2)) / whole)
    likelihood = float(np.sum(np.log(deviation**2))) + float(np.sum(np.abs(e) ** 2))
    likelihood += 0.5 * float(np.sum(known.misses(logs) ** 2))
    return Fit(logs, covariance, misfit, likelihood, len(f), converged)


def unlimited(parameters: int) -> tuple[FloatArray, FloatArray]:
    """Return wide limits, which only keep exponentials finite."""
    return np.full(parameters, -_FAR), np.full(parameters, _FAR)


def check_fit(recording: Recording, found: Fit, advice: str, *, resonance: bool = True) -> None:
    """Raise IdentificationError for a poor fit. resonance: whether f0 must be in the swept band."""
    if not found.converged:
        raise IdentificationError(
            f"the fit of {recording.names[1]} for {recording.names[0]} does not converge: its "
            "response is not that of one resonance; check the inputs, fasten loose parts, and "
            "sweep around the resonance"
        )
    sweep = recording.sweep
    low, high = 1.1 * sweep.low_hz, 0.9 * sweep.high_hz
    if resonance and not math.log(low) < found.logs[1] < math.log(high):
        below = found.logs[1] <= math.log(low)
        end, to = ("lower", "start lower") if below else ("upper", "go higher")
        raise IdentificationError(
            f"the resonance is outside the band, {low:.4g} to {high:.4g} Hz of a sweep from "
            f"{sweep.low_hz:.4g} to {sweep.high_hz:.4g} Hz: it is beyond the {end} end; {to}, or "
            "check the inputs"
        )
    if found.misfit > MOST_MISFIT:
        raise IdentificationError(
            f"the fit leaves {100 * found.misfit:.0f} % of the {recording.names[1]} unexplained, "
            f"at most {100 * MOST_MISFIT:.0f} % is allowed: {advice}"
        )


@dataclass(frozen=True)
class Extra:
    """An optional factor of a response beyond the simple model."""

    name: str
    factor: Factor
    starts: tuple[FloatArray, ...]  # start values of its parameters
    lowest: FloatArray
    highest: FloatArray
    doubt: float = 1.0  # factor on `penalty`


def penalty(parameters: int, bins: int) -> float:
    """Return the decrease of cost that justifies this number of added parameters (Schwarz 1978)."""
    return 0.5 * parameters * math.log(2 * bins)


def fit_with_extras(
    recording: Recording,
    factors: Sequence[Factor],
    starts: Sequence[FloatArray],
    extras: Sequence[Extra],
    is_identified: Callable[[Fit], bool] = lambda _: True,
) -> tuple[Fit, tuple[Extra, ...], float]:
    """Return the fit with the least cost plus penalties, its extras, and this sum.

    is_identified: whether a fit determines the parameters that are sought. An extra that makes them
    unknown is left out: its poles and zeros cancel each other.
    """
    found = fit(recording, product(*factors), starts)
    chosen: tuple[Extra, ...] = ()
    low, high = unlimited(len(found.logs))
    left = list(extras)
    paid = 0.0
    while left:
        tried = []
        for extra in left:
            model = product(*factors, *(one.factor for one in (*chosen, extra)))
            ends = np.concatenate([low, extra.lowest]), np.concatenate([high, extra.highest])
            more = [np.concatenate([found.logs, start]) for start in extra.starts]
            richer = fit(recording, model, more, ends)
            price = extra.doubt * penalty(extra.factor.parameters, richer.bins)
            if richer.converged and (is_identified(richer) or not is_identified(found)):
                tried.append((richer.cost + price, price, richer, extra, ends))
        if not tried:
            break
        score, price, richer, extra, ends = min(tried, key=lambda one: one[0])
        if found.converged and score >= found.cost:
            break
        found, chosen, (low, high), paid = richer, (*chosen, extra), ends, paid + price
        left.remove(extra)
    return found, chosen, found.cost + paid


def require(name: str, estimate: Estimate, relative: float, advice: str) -> None:
    """Raise IdentificationError if an estimate's interval is wider than ±`relative`."""
    if not (width := estimate.relative) <= relative:
        raise IdentificationError(
            f"{name} is not identified: its interval of 95 % is ±{100 * width:.3g} %, at most "
            f"±{100 * relative:.3g} % is allowed; {advice}"
        )

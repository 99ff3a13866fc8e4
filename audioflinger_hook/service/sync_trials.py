"""Estimates by how much a sound is later than its vibration, from a person's answers.

In each trial, the person hears a click and feels a tap of vibration, which an offset delays. The
person answers which of the two came first. The person perceives the delay minus the offset, plus
normally distributed scatter. If the magnitude of this sum is within the person's window, the answer
is "together". Some answers are lapses, which do not depend on the offset.

The estimate is Bayesian. A grid holds the probability of each delay, for persons of each scatter,
window and rate of lapses. Each trial uses the offset whose answer is expected to leave the lowest
entropy of the delay (L. L. Kontsevich, C. W. Tyler, Vision Research 39, 1999).

Times, answers and random numbers are arguments: nothing here reads a clock or waits.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import product

import numpy as np
from scipy.special import ndtr

from device.units import FloatArray

LONGEST_MS = 500.0  # longest delay of the grid, and largest offset of a trial
FOUND_MS = 480.0  # longest delay that can be found, because its credible interval is on the grid
EARLIEST_MS = -100.0  # the most by which the sound may come before its vibration
STEP_MS = 4.0  # step of the grid; the estimate is a mean, so it is finer

SCATTERS_MS = (5.0, 10.0, 20.0, 40.0, 80.0)  # standard deviations
WINDOWS_MS = (0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 160.0)
LAPSES = (0.02, 0.1)  # shares of all answers

# Prior probabilities. If the delay is shorter than the window, no offset is answered with "felt
# first", and the answers alone do not tell a short delay from a wide window.
USUAL_WINDOW_MS = 25.0  # the probability of a window falls by a factor of e in every such step
NEGATIVE = 0.5  # probability of a delay below 0, relative to a positive delay

# Scatter, window and lapses of persons who guess, or find everything together. Their answers tell
# nothing about the delay. CARELESS_SHARE: prior probability of such a person.
CARELESS, CARELESS_SHARE = ((20.0, 20.0, 0.9), (20.0, 1_000.0, 0.1)), 0.3

LEAST = 8  # least number of trials, because the first answers may be lapses
LONGEST_S = 60.0  # longest duration of the trials
CREDIBLE = 0.95  # probability of the credible interval
NARROW_MS = 14.0  # the trials end when the credible interval is this narrow
WIDE_MS = 60.0  # a result with a wider credible interval is not usable

COMPARED = 24  # number of offsets that are compared before a trial, up to twice this number
MARGIN_MS = 100.0  # the compared offsets lie at most this far outside of the credible interval

_DELAYS_MS = np.arange(EARLIEST_MS, LONGEST_MS + 1.0, STEP_MS)
_OFFSETS_MS = _DELAYS_MS[_DELAYS_MS >= 0.0]


class Answer(Enum):
    """What came first."""

    FELT_FIRST = "felt first"
    HEARD_FIRST = "heard first"
    TOGETHER = "together"


_ANSWERS: tuple[Answer, ...] = (*Answer,)


@dataclass(frozen=True)
class Estimate:
    """A delay of the sound in ms, with the ends of its credible interval, all at least 0.

    is_clipped: whether the sound probably comes before its vibration, so that the delay is 0.
    """

    delay_ms: float
    low_ms: float
    high_ms: float
    is_clipped: bool

    @property
    def width_ms(self) -> float:
        """Width of the credible interval."""
        return self.high_ms - self.low_ms

    @property
    def is_usable(self) -> bool:
        """Whether the answers agree, and the delay is not longer than can be found."""
        return self.width_ms <= WIDE_MS and self.high_ms < LONGEST_MS - STEP_MS


class SyncTrials:
    """The trials of one person. began_s: time at the start. count: number of answers."""

    def __init__(self, began_s: float) -> None:
        self._began_s = began_s
        self._likelihoods = _likelihoods()
        self._posterior = _prior()
        self.count = 0

    def estimate(self) -> Estimate:
        """Return the delay according to the answers up to now."""
        mean_ms = float(self._posterior.sum(axis=1) @ _DELAYS_MS)
        low_ms, high_ms = (max(0.0, end_ms) for end_ms in self._interval_ms())
        return Estimate(max(0.0, mean_ms), low_ms, high_ms, is_clipped=mean_ms < 0.0)

    def is_over(self, now_s: float) -> bool:
        """Whether the estimate is precise enough, or the time is up."""
        is_narrow = self.count >= LEAST and self.estimate().width_ms <= NARROW_MS
        return is_narrow or self.left_s(now_s) <= 0.0

    def left_s(self, now_s: float) -> float:
        """Return the time until the time is up; negative afterwards."""
        return self._began_s + LONGEST_S - now_s

    def next_ms(self) -> float:
        """Return the offset for the next trial, 0 to LONGEST_MS."""
        low_ms, high_ms = self._interval_ms()
        outside_ms = np.maximum(low_ms - _OFFSETS_MS, _OFFSETS_MS - high_ms)
        # If the whole interval is far below 0, the offset 0 is still possible.
        near = _OFFSETS_MS[outside_ms <= max(MARGIN_MS, outside_ms.min())]
        return float(min(near[:: max(1, near.size // COMPARED)], key=self._expected_entropy))

    def add(self, offset_ms: float, answer: Answer) -> None:
        """Use the answer to a trial with an offset from `next_ms`."""
        self._posterior = self._posterior * self._likelihoods_at(offset_ms)[_ANSWERS.index(answer)]
        self._posterior /= self._posterior.sum()
        self.count += 1

    def _interval_ms(self) -> tuple[float, float]:
        weights = self._posterior.sum(axis=1)
        below = np.cumsum(weights) - 0.5 * weights
        tail = 0.5 * (1.0 - CREDIBLE)
        low_ms, high_ms = np.interp((tail, 1.0 - tail), below, _DELAYS_MS)
        return float(low_ms), float(high_ms)

    def _expected_entropy(self, offset_ms: float) -> float:
        """Return the expected entropy of the delay after a trial, in nats."""
        likelihoods = self._likelihoods_at(offset_ms)
        joint = np.einsum("dp,adp->ad", self._posterior, likelihoods)  # of answers and delays
        return _entropy(joint) - _entropy(joint.sum(axis=1))

    def _likelihoods_at(self, offset_ms: float) -> FloatArray:
        """Return the probability of each answer, (answers, delays, persons)."""
        first = round((LONGEST_MS - offset_ms) / STEP_MS)
        return self._likelihoods[:, first : first + _DELAYS_MS.size]


@dataclass
class SimulatedPerson:
    """A person whose answers follow the model. All times are in ms. lapses: share of answers."""

    delay_ms: float
    scatter_ms: float
    random: np.random.Generator
    window_ms: float = 20.0
    lapses: float = 0.02

    def answer(self, offset_ms: float) -> Answer:
        """Return the answer to a trial with this offset."""
        if self.random.random() < self.lapses:
            return _ANSWERS[int(self.random.integers(len(_ANSWERS)))]
        perceived_ms = self.random.normal(self.delay_ms - offset_ms, self.scatter_ms)
        if abs(perceived_ms) <= self.window_ms:
            return Answer.TOGETHER
        return Answer.FELT_FIRST if perceived_ms > 0.0 else Answer.HEARD_FIRST


_PERSONS = np.array([*product(SCATTERS_MS, WINDOWS_MS, LAPSES), *CARELESS])


def _prior() -> FloatArray:
    """Return the probability of each delay and person before the first answer."""
    delays = np.where(_DELAYS_MS < 0.0, NEGATIVE, 1.0)
    persons = np.exp(-_PERSONS[:, 1] / USUAL_WINDOW_MS)
    persons[: -len(CARELESS)] *= (1.0 - CARELESS_SHARE) / persons[: -len(CARELESS)].sum()
    persons[-len(CARELESS) :] = CARELESS_SHARE / len(CARELESS)
    return np.outer(delays / delays.sum(), persons)


def _likelihoods() -> FloatArray:
    """Return the probability of each answer, (answers, differences, persons).

    differences: delay minus offset, in steps of STEP_MS up to LONGEST_MS.
    """
    differences_ms = np.arange(EARLIEST_MS - LONGEST_MS, LONGEST_MS + 1.0, STEP_MS)[:, None]
    scatters_ms, windows_ms, lapses = _PERSONS.T
    felt = ndtr((differences_ms - windows_ms) / scatters_ms)
    heard = ndtr((-differences_ms - windows_ms) / scatters_ms)
    meant = np.array([felt, heard, 1.0 - felt - heard])
    likelihoods: FloatArray = (1.0 - lapses) * meant + lapses / len(_ANSWERS)
    return likelihoods


def _entropy(weights: FloatArray) -> float:
    return -float(weights.ravel() @ np.log(np.maximum(weights, 1e-300)).ravel())

"""What each paradigm measures: estimates with 95 % intervals, and a test that nothing differs.

Each estimate is a function of a mean over participants, and SciPy's bootstrap draws participants.
Its percentiles are Hesterberg's expanded ones (American Statistician 69, 2015), because plain ones
are too narrow for few participants. The bootstrap's bias is subtracted from the estimate.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import expit, xlogy

from audioflinger_hook.study.curves import Curve, count, probability
from audioflinger_hook.study.design import Question
from device.units import FloatArray

RESAMPLES, LEVEL = 2_000, 0.95
Answered = Sequence[Mapping[str, Any]]  # the recorded rows of a participant, practice left out


def chance(question: Question, row: Mapping[str, Any], person: Mapping[str, Any]) -> float:
    """Return the probability that a person's answer is the counted one, without lapses.

    person: each parameter of the paradigm, one value for each condition. Ratings have no chance.
    """
    at = question.conditions.index(row["tested"])
    if question.paradigm == "preference":
        other = question.conditions.index(row["against"])
        return float(expit(person["worth"][at] - person["worth"][other]))
    if question.paradigm == "identification":
        return float(person["accuracy"][at])
    place, width = (person[key][at] for key in question.kind["parameters"])
    return float(probability(question, row["varied"], place, width))


class Measured(NamedTuple):
    """What a question has measured.

    names: of the estimates. features: of each participant, (people, ...). score: of each
    participant, of mean 0 if nothing differs; None if nothing is compared. statistic: computes
    estimates (draws, names) from means of features (draws, ...).
    """

    names: Sequence[str]
    features: FloatArray
    score: FloatArray | None
    statistic: Callable[[FloatArray], FloatArray] = lambda mean: mean


def measure(question: Question, people: Sequence[Answered]) -> Measured:
    """Return what the rows of each participant measure."""
    if question.kind["varies"] == "nothing":
        counted = {"preference": _wins, "rating": _ratings, "identification": _confusion}
        return counted[question.paradigm](question, people)
    curve, n = Curve(question, 21), len(people)
    counts = np.array([count(rows, curve.axes) for rows in people])
    if question.kind["varies"] == "delay":
        place, width = curve.joined(curve.given_width(counts.sum(axis=2)))
        found, score = {"PSS": place, "JND": width}, place.mean(axis=1)
        if question.judgement == "simultaneity":
            found |= {"noticed below": place - width, "noticed above": place + width}
        labels = [f"{what}, {name}" for what in found for name in curve.tested]
        return Measured(labels, np.concatenate([*found.values()], axis=1), score)
    # A person's few adaptive trials tell little about the width, so that all people share it.
    log, place = curve.given_width(counts)
    features = np.stack([log.sum(axis=2), place.mean(axis=2)], axis=1)  # (people, 2, tested, cells)
    shared = np.broadcast_to(features[:, 0].mean(axis=0), features[:, 0].shape)
    own = curve.joined(np.stack([shared, features[:, 1]]), n)[0]
    score = own.mean(axis=1)
    if question.paradigm == "threshold":  # no single threshold is tested, but differences
        score = own[:, 0] - own[:, 1:].mean(axis=1) if len(curve.tested) > 1 else None
    labels = [f"{what}, {name}" for what in ("level", "JND") for name in curve.tested]
    joined = lambda mean: np.concatenate([*curve.joined(mean.swapaxes(0, 1), n)], axis=1)  # noqa: E731
    return Measured(labels, features, score, joined)


def _wins(question: Question, people: Sequence[Answered]) -> Measured:
    names = list(question.conditions)
    axes = {"tested": names, "against": names, "is_counted": [True, False]}
    counts = np.array([count(rows, axes) for rows in people])
    wins = counts[..., 0] + counts[..., 1].swapaxes(1, 2)
    score = (wins[:, 0] - wins[:, :, 0]).sum(axis=1)
    virtual = 0.25 / len(people) / len(names)  # keeps a condition that never wins finite
    labels = [*names, *(f"{names[0]} over {name}" for name in names[1:])]
    return Measured(labels, wins, score, lambda mean: bradley_terry(mean + virtual))


def _ratings(question: Question, people: Sequence[Answered]) -> Measured:
    names, hidden = question.conditions, (question.reference, question.anchor)
    mean = np.array(
        [
            [np.mean([r["answer"] for r in rows if r["tested"] == n]) for n in names]
            for rows in people
        ]
    )
    shown = [k for k, name in enumerate(names) if name not in hidden]
    first, others = shown[0], shown[1:] or [names.index(question.anchor)]
    over = mean[:, [first]] - mean[:, others]
    labels = [*names, *(f"{names[first]} over {names[other]}" for other in others)]
    return Measured(labels, np.concatenate([mean, over], axis=1), over.mean(axis=1))


def _confusion(question: Question, people: Sequence[Answered]) -> Measured:
    names, sounds = question.conditions, question.stimuli
    axes = {"tested": names, "stimulus": sounds, "answer": sounds}
    confusion = np.array([count(rows, axes) for rows in people])
    right = np.trace(confusion, axis1=2, axis2=3) / confusion.sum(axis=(2, 3))
    labels = [f"{what}, {name}" for what in ("right", "bits") for name in names]
    return Measured(labels, confusion, right.mean(axis=1) - 1.0 / len(sounds), information)


def bradley_terry(wins: FloatArray) -> FloatArray:
    """Return log odds of each condition against the average, and of the first against each.

    wins: (draws, conditions, conditions), of the second index over the third. The iteration is that
    of Newman (Journal of Machine Learning Research 24, 2023).
    """
    odds = np.ones(wins.shape[:2])
    wins = wins * (1.0 - np.eye(wins.shape[1]))
    for _ in range(2_000):
        share = 1.0 / (odds[:, :, None] + odds[:, None])
        before, lost = odds, (wins.swapaxes(1, 2) * share).sum(axis=2)
        odds = (wins * odds[:, None] * share).sum(axis=2) / lost
        odds /= np.exp(np.log(odds).mean(axis=1, keepdims=True))
        if np.abs(np.log(odds / before)).max() < 1e-7:
            break
    worth = np.log(odds)
    return np.concatenate([worth, worth[:, :1] - worth[:, 1:]], axis=1)


def information(confusion: FloatArray) -> FloatArray:
    """Return shares of right answers and mutual information in bits, (draws, 2 x conditions).

    confusion: answers, (draws, conditions, sounds played, sounds answered).
    """
    p = confusion / confusion.sum(axis=(-2, -1), keepdims=True)
    entropies = [-xlogy(q, q).sum(axis=-1) for q in (p.sum(axis=-1), p.sum(axis=-2))]
    bits = (sum(entropies) + xlogy(p, p).sum(axis=(-2, -1))) / np.log(2.0)
    return np.concatenate([np.trace(p, axis1=-2, axis2=-1), bits], axis=-1)


def estimate(measured: Measured, seed: int) -> FloatArray:
    """Return values, and lower and upper ends of the intervals, (3, names). seed: of the bootstrap.

    The intervals of one participant are NaN.
    """
    n = len(measured.features)

    def statistic(drawn: NDArray[np.intp], axis: int = -1) -> FloatArray:
        counts = np.stack([np.bincount(one, minlength=n) for one in np.atleast_2d(drawn)])
        return measured.statistic(np.tensordot(counts / n, measured.features, 1)).T

    values = statistic(np.arange(n))[:, 0]
    if n == 1:
        return np.stack([values, *np.full((2, len(values)), np.nan)])
    tail = stats.norm.cdf(np.sqrt(n / (n - 1)) * stats.t.ppf(0.5 - 0.5 * LEVEL, n - 1))
    drawn = stats.bootstrap(
        (np.arange(n),), statistic, n_resamples=RESAMPLES, vectorized=True,
        confidence_level=1.0 - 2.0 * tail, method="percentile", random_state=seed,
    )  # fmt: skip
    lows, highs = drawn.confidence_interval
    values = 2.0 * values - drawn.bootstrap_distribution.mean(axis=-1)
    return np.stack([np.clip(values, lows, highs), lows, highs])


def p_value(measured: Measured) -> float | None:
    """Return p of the t test that the mean score is 0; None for one participant or no score."""
    if measured.score is None or (n := len(measured.score)) == 1:
        return None
    error = np.std(measured.score, ddof=1) / np.sqrt(n) + 1e-9  # all participants may agree
    return float(2.0 * stats.t.sf(abs(np.mean(measured.score)) / error, n - 1))

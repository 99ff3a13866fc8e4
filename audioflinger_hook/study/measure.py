"""What each paradigm measures: estimates with 95 % intervals, and a test that nothing differs.

Each estimate is a function of a mean over participants, and SciPy's bootstrap draws participants.
Its percentiles are Hesterberg's expanded ones (American Statistician 69, 2015), because plain ones
are too narrow for few participants. The bootstrap's bias is subtracted from the estimate.

Psychometric functions are computed on a grid of their parameters. Each place of the grid has equal
prior weight, and each width for equal ratios. The same grid gives the next level of an adaptive
trial: the one with the least expected entropy (QUEST+, Watson, Journal of Vision 17, 2017).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import expit, logsumexp, ndtr, softmax, xlogy

from audioflinger_hook.study.design import Question
from device.units import FloatArray

RESAMPLES, LEVEL = 2_000, 0.95
HALF, QUARTILE = 1.177410, 0.674490  # of a normal density half its height, of its area 75 %
LAPSES = (0.0, 0.01, 0.03)
Answered = Sequence[Mapping[str, Any]]  # the recorded rows of a participant, practice left out


def probability(question: Question, x: Any, place: Any, width: Any) -> FloatArray:
    """Return the probability of the counted answer without lapses, in arrays that fit together.

    For simultaneity, place is the point of subjective simultaneity, and half of the answers are yes
    at place - width and place + width. For order, width is from 50 to 75 %. For levels, width is
    the standard deviation of the decision, and place is answered with 75 % (threshold) or 50 %.
    """
    if question.paradigm == "synchrony" and question.judgement == "simultaneity":
        return np.asarray(np.exp(-0.5 * (HALF * (x - place) / width) ** 2))
    scale = QUARTILE if question.paradigm == "synchrony" else 1.0
    share = np.asarray(ndtr(scale * (x - place) / width))
    return 0.5 + 0.5 * share if question.paradigm == "threshold" else share


def count(rows: Iterable[Mapping[str, Any]], axes: Mapping[str, Sequence[Any]]) -> FloatArray:
    """Return how many rows have each combination of values. axes: values of each column.

    The column "is_counted" is whether the answer is the counted one.
    """
    counts = np.zeros([len(values) for values in axes.values()])
    for row in rows:
        all_of = {**row, "is_counted": row["answer"] == row["counted"]}
        counts[tuple(values.index(all_of[key]) for key, values in axes.items())] += 1.0
    return counts


class Curve:
    """The grid of a question. xs: places of trials. axes: of `count`, (tested, sounds, xs, 2)."""

    def __init__(self, question: Question, widths_db: int = 7) -> None:
        if question.kind["varies"] == "level":
            self.xs = np.arange(question.lowest_db, question.highest_db + 0.5)
            self._places, self._widths = self.xs, np.geomspace(0.4, 8.0, widths_db)
        else:
            self.xs = np.array(sorted(question.offsets_ms), dtype=float)
            self._places, self._widths = np.linspace(-150, 150, 76), np.geomspace(8, 400, 40)
        self.tested = [pair[0] for pair in question.pairs]
        self.axes = {"tested": self.tested, "stimulus": question.stimuli, "varied": list(self.xs)}
        self.axes["is_counted"] = [True, False]
        place, width, lapse = np.meshgrid(self._places, self._widths, LAPSES, indexing="ij")
        p = probability(question, self.xs[:, None, None, None], place, width)
        p = np.clip(0.5 * lapse + (1.0 - lapse) * p, 1e-6, 1.0 - 1e-6)
        self._p = np.stack([p, 1.0 - p], axis=1).reshape(len(self.xs), 2, len(self._places), -1)
        self._log_p, self._entropy = np.log(self._p), xlogy(self._p, self._p)
        self._log_widths = np.repeat(np.log(self._widths), len(LAPSES))

    def given_width(self, counts: FloatArray) -> FloatArray:
        """Return log likelihood and mean of the place for each width and lapse, (2, ..., cells).

        counts: of answers, (..., xs, 2).
        """
        log = np.tensordot(counts, self._log_p, 2)
        place = np.swapaxes(softmax(log, axis=-2), -2, -1) @ self._places
        return np.stack([logsumexp(log, axis=-2), place])

    def joined(self, given: FloatArray, people: int = 1) -> FloatArray:
        """Return means of place and width, (2, ...), if all people have one width and lapse.

        given: results of `given_width`, averaged over people, (2, ..., cells).
        """
        weight = softmax(people * given[0], axis=-1)
        place = (weight * given[1]).sum(axis=-1)
        return np.stack([place, np.exp(weight @ self._log_widths)])

    def next_x(self, counts: FloatArray) -> float:
        """Return the place of the most informative next trial. counts: of one kind, (xs, 2)."""
        weight = softmax(np.tensordot(counts, self._log_p, 2))
        p = np.tensordot(self._p, weight, 2)  # (xs, 2)
        told = np.tensordot(self._entropy, weight, 2) - xlogy(p, p)
        return float(self.xs[int(np.argmax(told.sum(axis=1)))])


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
    rated = [[[r["answer"] for r in rows if r["tested"] == n] for n in names] for rows in people]
    mean = np.mean(rated, axis=2)
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

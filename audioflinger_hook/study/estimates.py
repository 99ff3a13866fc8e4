"""Estimates of a study's parameters, with 95 % intervals, and tests that nothing differs.

Each estimate is a function of a mean over participants, and SciPy's bootstrap draws participants.
Its percentiles are Hesterberg's expanded ones (American Statistician 69, 2015), because plain ones
are too narrow for few participants. The bootstrap's bias is subtracted from the estimate.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import xlogy

from audioflinger_hook.study.curves import Curve
from audioflinger_hook.study.design import Question
from audioflinger_hook.study.people import People, chosen_probability
from audioflinger_hook.study.trials import FIRST, SECOND, Trial, balanced, counted, tested
from device.units import FloatArray

RESAMPLES, LEVEL = 2_000, 0.95
Answered = Sequence[tuple[Trial, Any]]  # the trials of a participant, and the answers


@dataclass(frozen=True)
class Measured:
    """What a question has measured.

    names, unit: of the estimates. features: of each participant, (people, ...). statistic: computes
    estimates (draws, names) from means of features (draws, ...). scores: (people, tests), of mean 0
    if nothing differs. tests: names of the tests. low, high: bounds of the estimates.
    """

    names: Sequence[str]
    unit: str
    features: FloatArray
    statistic: Callable[[FloatArray], FloatArray]
    scores: FloatArray
    tests: Sequence[str]
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class Estimate:
    """Estimates of a question. values, lows, highs: (names,). p: of all tests together; None
    without tests or with too few participants. p_of: of each test, adjusted after Holm.
    """

    names: Sequence[str]
    unit: str
    people: int
    values: FloatArray
    lows: FloatArray
    highs: FloatArray
    p: float | None
    p_of: Mapping[str, float] = field(default_factory=dict)


def estimate(measured: Measured, seed: int) -> Estimate:
    """Return estimates with intervals and tests. seed: of the bootstrap."""
    n = len(measured.features)

    def statistic(drawn: NDArray[np.intp], axis: int = -1) -> FloatArray:
        counts = np.stack([np.bincount(one, minlength=n) for one in np.atleast_2d(drawn)])
        return measured.statistic(np.tensordot(counts / n, measured.features, 1)).T

    values = statistic(np.arange(n))[:, 0]
    lows, highs = np.full((2, len(values)), np.nan)
    if n > 1:
        tail = stats.norm.cdf(np.sqrt(n / (n - 1)) * stats.t.ppf(0.5 - 0.5 * LEVEL, n - 1))
        drawn = stats.bootstrap(
            (np.arange(n),), statistic, n_resamples=RESAMPLES, vectorized=True,
            confidence_level=1.0 - 2.0 * tail, method="percentile", random_state=seed,
        )  # fmt: skip
        lows, highs = drawn.confidence_interval
        values = 2.0 * values - drawn.bootstrap_distribution.mean(axis=-1)
    values, lows, highs = np.clip((values, lows, highs), measured.low, measured.high)
    p, p_of = p_values(measured)
    return Estimate(measured.names, measured.unit, n, values, lows, highs, p, p_of)


def p_values(measured: Measured) -> tuple[float | None, dict[str, float]]:
    """Return p of Hotelling's test that all means are 0, and p of each t test after Holm."""
    scores, names = measured.scores, measured.tests
    n, d = scores.shape
    if d == 0 or n <= d + 1:
        return None, {}
    mean, cov = scores.mean(axis=0), np.cov(scores, rowvar=False).reshape(d, d)
    cov += 1e-9 * np.eye(d)  # all participants may agree
    f = n * float(mean @ np.linalg.solve(cov, mean)) * (n - d) / (d * (n - 1))
    t = mean / np.sqrt(np.diag(cov) / n)
    single = 2.0 * stats.t.sf(np.abs(t), n - 1)
    order = np.argsort(single)
    holm = np.minimum(1.0, np.maximum.accumulate(single[order] * (d - np.arange(d))))
    return float(stats.f.sf(f, d, n - d)), {
        names[i]: float(p) for i, p in zip(order, holm, strict=True)
    }


def measure(question: Question, people: Sequence[Answered]) -> Measured:
    """Return what the trials and answers of each participant measure, practice left out.

    An answer is one of the trial's choices, or a rating.
    """
    return _MEASURES[question.paradigm](question, people)


def _preference(question: Question, people: Sequence[Answered]) -> Measured:
    names = list(question.conditions)
    wins = np.array([_table(question, [(t, {a: 1.0}) for t, a in rows]) for rows in people])
    tests = [f"{names[0]} over {name}" for name in names[1:]]
    scores = (wins[:, 0] - wins[:, :, 0])[:, 1:]
    virtual = 0.25 / len(people) / len(names)  # keeps a condition that never wins finite
    labels = [*names, *tests]
    return Measured(labels, "log odds", wins, lambda w: _bradley_terry(w + virtual), scores, tests)


def _table(question: Question, rows: Sequence[tuple[Trial, Mapping[str, float]]]) -> FloatArray:
    """Return sums of answers: of wins of a condition over another, or of sounds and answers.

    rows: trials with the weight of each answer. Shape: (conditions, conditions), or (conditions,
    sounds played, sounds answered).
    """
    names, sounds = list(question.conditions), list(question.stimuli)
    if question.paradigm == "preference":
        table = np.zeros((len(names), len(names)))
        for trial, answers in rows:
            one, other = (names.index(name) for name in trial.conditions)
            table[one, other] += answers.get(FIRST, 0.0)
            table[other, one] += answers.get(SECOND, 0.0)
        return table
    table = np.zeros((len(names), len(sounds), len(sounds)))
    for trial, answers in rows:
        for sound, weight in answers.items():
            place = names.index(trial.conditions[0]), sounds.index(trial.stimulus)
            table[(*place, sounds.index(sound))] += weight
    return table


def _bradley_terry(wins: FloatArray) -> FloatArray:
    """Return log odds of each condition against the average, and of the first against each.

    wins: (draws, conditions, conditions), of the second index over the third; fitted by Newton.
    """
    n = wins.shape[1]
    worth = np.zeros(wins.shape[:2])
    games = (wins + wins.swapaxes(1, 2)) * (1.0 - np.eye(n))
    won = (wins * (1.0 - np.eye(n))).sum(axis=2)
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(worth[:, None, :] - worth[:, :, None]))
        slope = games * p * (1.0 - p)
        curvature = np.eye(n) * slope.sum(axis=2)[:, :, None] - slope
        gradient = won - (games * p).sum(axis=2)
        scale = np.maximum(slope.max(axis=(1, 2)), 1e-9)[:, None, None]
        step = np.linalg.solve(curvature + scale / n, gradient[:, :, None])[:, :, 0]
        step = np.clip(step, -1.0, 1.0)
        worth += step - step.mean(axis=1, keepdims=True)
        if np.abs(step).max() < 1e-6:
            break
    return np.concatenate([worth, worth[:, :1] - worth[:, 1:]], axis=1)


def _rating(question: Question, people: Sequence[Answered]) -> Measured:
    names = list(question.conditions)
    of = [[[a for t, a in rows if t.conditions[1] == name] for name in names] for rows in people]
    features = np.array([[np.mean(one) for one in person] for person in of])
    shown = [name for name in names if name not in (question.reference, question.anchor)]
    against = shown[1:] or [question.anchor]
    first = features[:, names.index(shown[0])]
    scores = np.stack([first - features[:, names.index(name)] for name in against], axis=1)
    tests = [f"{shown[0]} over {name}" for name in against]
    return Measured(names, "of 100", features, lambda mean: mean, scores, tests, 0.0, 100.0)


def counts(question: Question, curve: Curve, rows: Answered) -> dict[tuple[str, str], FloatArray]:
    """Return counts of (yes, no) for each place, (2, xs), by tested condition and sound."""
    found: dict[tuple[str, str], FloatArray] = {}
    for trial, answer in rows:
        place = 0 if question.paradigm == "synchrony" else tested(trial, question)
        x = trial.offset_ms if question.paradigm == "synchrony" else trial.gains_db[place]
        key = trial.conditions[place], trial.stimulus
        one = found.setdefault(key, np.zeros((2, len(curve.xs))))
        one[int(not counted(trial, question, answer)), curve.index(x)] += 1.0
    return found


def _synchrony(question: Question, people: Sequence[Answered]) -> Measured:
    curve, names = Curve(question), list(question.conditions)
    features = np.zeros((len(people), 2, len(names)))
    for k, rows in enumerate(people):
        found = counts(question, curve, rows)
        for c, name in enumerate(names):
            sounds = [one for (condition, _), one in found.items() if condition == name]
            features[k, :, c] = curve.estimate(*np.sum(sounds, axis=0))
    if question.judgement == "simultaneity":
        ends = [features[:, 0] - features[:, 1], features[:, 0] + features[:, 1]]
        features = np.concatenate([features, np.stack(ends, axis=1)], axis=1)
    kinds = ("PSS", "JND", "noticed below", "noticed above")[: features.shape[1]]
    labels = [f"{what}, {name}" for what in kinds for name in names]
    flat, tests = features.reshape(len(people), -1), labels[: len(names)]
    return Measured(labels, "ms", flat, lambda mean: mean, features[:, 0], tests)


def _levels(question: Question, people: Sequence[Answered]) -> Measured:
    # A person's few adaptive trials tell little about the width, so that all people share it.
    curve, names = Curve(question, 21), [pair[0] for pair in question.pairs]
    each = []
    for rows in people:
        found = counts(question, curve, rows)
        sounds = [[curve.given_width(*found[key]) for key in found if key[0] == n] for n in names]
        each.append([[np.sum(s, axis=0)[0], np.mean(s, axis=0)[1]] for s in sounds])
    features = np.array(each)  # (people, conditions, 2, cells)
    n = len(people)

    def statistic(mean: FloatArray) -> FloatArray:
        return curve.joined(mean, n).swapaxes(1, 2).reshape(len(mean), -1)

    what = "threshold" if question.paradigm == "threshold" else "equal strength"
    labels = [f"{one}, {name}" for one in (what, "JND") for name in names]
    own = features.copy()
    own[:, :, 0] = features[:, :, 0].mean(axis=0)
    scores, tests = curve.joined(own, n)[:, :, 0], labels[: len(names)]
    if question.paradigm == "threshold":  # no single threshold is tested, but differences
        scores = scores[:, :1] - scores[:, 1:]
        tests = [f"{names[0]} over {name}" for name in names[1:]]
    return Measured(labels, "dB", features, statistic, scores, tests)


def _identification(question: Question, people: Sequence[Answered]) -> Measured:
    names, sounds = list(question.conditions), list(question.stimuli)
    confusion = np.array([_table(question, [(t, {a: 1.0}) for t, a in rows]) for rows in people])
    right = np.trace(confusion, axis1=2, axis2=3) / confusion.sum(axis=(2, 3))
    labels = [f"right, {name}" for name in names]
    scores, tests = right - 1.0 / len(sounds), [f"{label}, over chance" for label in labels]
    labels = labels + [f"bits, {name}" for name in names]
    return Measured(labels, "share; bits", confusion, _information, scores, tests, 0.0)


def _information(confusion: FloatArray) -> FloatArray:
    """Return shares of right answers and mutual information in bits, (draws, 2 x conditions)."""
    p = confusion / confusion.sum(axis=(-2, -1), keepdims=True)
    entropies = [-xlogy(q, q).sum(axis=-1) for q in (p.sum(axis=-1), p.sum(axis=-2))]
    joint = -xlogy(p, p).sum(axis=(-2, -1))
    bits = (entropies[0] + entropies[1] - joint) / np.log(2.0)
    return np.concatenate([np.trace(p, axis1=-2, axis2=-1), bits], axis=-1)


def truth(question: Question, people: People) -> FloatArray:
    """Return the true values of what `measure` estimates, for people drawn without end.

    For preference and identification, it is computed from the mean probabilities of all answers.
    """
    drawn = people.many(question.name)
    if question.paradigm in ("preference", "identification"):
        kinds = {(t.conditions, t.stimulus): t for t in balanced(question, 0)}.values()
        expected = []
        for trial in kinds:
            p = np.mean([chosen_probability(question, trial, one) for one in drawn], axis=0)
            expected.append((trial, dict(zip(trial.choices, p, strict=True))))
        statistic = _bradley_terry if question.paradigm == "preference" else _information
        return np.asarray(statistic(_table(question, expected)[None])[0])
    keys = [key for key in drawn[0] if key not in ("lapse", "noise")]
    if question.paradigm == "rating":
        z = stats.norm.ppf((np.arange(200) + 0.5) / 200)  # ratings end at 0 and 100
        rated = [
            (1.0 - one["lapse"]) * np.clip(one["rating"] + z[:, None] * one["noise"], 0, 100)
            + one["lapse"] * 50.0
            for one in drawn
        ]
        return np.asarray(np.mean(rated, axis=(0, 1)))
    mean = [np.mean([one[key] for one in drawn], axis=0) for key in keys]
    places = [question.conditions.index(pair[0]) for pair in question.pairs]
    place, jnd = (one[places] for one in mean)
    is_window = question.paradigm == "synchrony" and question.judgement == "simultaneity"
    return np.concatenate([place, jnd, *([place - jnd, place + jnd] if is_window else ())])


_MEASURES = {
    "preference": _preference,
    "rating": _rating,
    "synchrony": _synchrony,
    "threshold": _levels,
    "equal": _levels,
    "identification": _identification,
}

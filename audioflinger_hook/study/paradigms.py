"""What each paradigm measures from recorded rows, and how a person with known parameters answers.

`built_in/paradigms.toml` has the other columns of this table.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import xlogy

from audioflinger_hook.study.curves import Curve, place, probability, tested
from audioflinger_hook.study.design import Question
from audioflinger_hook.study.estimates import Measured
from device.units import FloatArray

Answered = Sequence[Mapping[str, Any]]  # the recorded rows of a participant, practice left out


def chances(question: Question, row: Mapping[str, Any], person: Mapping[str, Any]) -> FloatArray:
    """Return the probability of each of the row's choices, without lapses.

    person: each parameter of the paradigm, one value for each condition. Ratings have no choices.
    """
    at = [question.conditions.index(row[key]) for key in ("condition_1", "condition_2")
          if row.get(key) in question.conditions]  # fmt: skip
    if question.paradigm == "preference":
        one, other = person["worth"][at]
        chance, counted = 1.0 / (1.0 + np.exp(other - one)), "1"
    elif question.paradigm == "identification":
        chance, counted = float(person["accuracy"][at[0]]), row["stimulus"]
    else:
        x, counted = place(row, question)
        at = [question.conditions.index(row[f"condition_{tested(row, question)}"])]
        where, jnd = (person[key][at] for key in question.kind["parameters"])
        chance = float(probability(question, np.array(x), where, jnd)[0])
    others = (1.0 - chance) / (len(row["choices"]) - 1)
    return np.array([chance if choice == counted else others for choice in row["choices"]])


def measure(question: Question, people: Sequence[Answered]) -> Measured:
    """Return what the rows of each participant measure."""
    return _MEASURES[question.paradigm](question, list(question.conditions), people)


def _preference(question: Question, names: list[str], people: Sequence[Answered]) -> Measured:
    wins = np.zeros((len(people), len(names), len(names)))
    for k, rows in enumerate(people):
        for row in rows:
            pair = [names.index(row[f"condition_{i}"]) for i in (1, 2)]
            better = int(row["answer"]) - 1
            wins[k, pair[better], pair[1 - better]] += 1.0
    tests = [f"{names[0]} over {name}" for name in names[1:]]
    scores = (wins[:, 0] - wins[:, :, 0])[:, 1:]
    virtual = 0.25 / len(people) / len(names)  # keeps a condition that never wins finite
    return Measured([*names, *tests], wins, scores, tests, lambda w: bradley_terry(w + virtual))


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


def _rating(question: Question, names: list[str], people: Sequence[Answered]) -> Measured:
    of = [[[r["answer"] for r in rows if r["condition_2"] == n] for n in names] for rows in people]
    features = np.array([[np.mean(one) for one in person] for person in of])
    shown = [name for name in names if name not in (question.reference, question.anchor)]
    against = shown[1:] or [question.anchor]
    first, others = (features[:, [*map(names.index, of)]] for of in ([shown[0]], against))
    tests = [f"{shown[0]} over {name}" for name in against]
    return Measured(names, features, first - others, tests, low=0.0, high=100.0)


def _synchrony(question: Question, names: list[str], people: Sequence[Answered]) -> Measured:
    curve, features = Curve(question), np.zeros((len(people), 2, len(names)))
    for k, rows in enumerate(people):
        found = curve.counts(rows)
        for c, name in enumerate(names):
            yes, no = np.sum([one for key, one in found.items() if key[0] == name], axis=0)
            features[k, :, c] = curve.estimate(yes, no)
    kinds = ["PSS", "JND"]
    if question.judgement == "simultaneity":
        kinds += ["noticed below", "noticed above"]
        pss, jnd = features[:, :1], features[:, 1:]
        features = np.concatenate([pss, jnd, pss - jnd, pss + jnd], axis=1)
    labels = [f"{what}, {name}" for what in kinds for name in names]
    flat = features.reshape(len(people), -1)
    return Measured(labels, flat, features[:, 0], labels[: len(names)])


def _levels(question: Question, names: list[str], people: Sequence[Answered]) -> Measured:
    # A person's few adaptive trials tell little about the width, so that all people share it.
    curve, names, n = Curve(question, 21), [pair[0] for pair in question.pairs], len(people)
    each = []
    for rows in people:
        found = curve.counts(rows)
        sounds = [[curve.given_width(*found[key]) for key in found if key[0] == n] for n in names]
        each.append([[np.sum(s, axis=0)[0], np.mean(s, axis=0)[1]] for s in sounds])
    features = np.array(each)  # (people, conditions, 2, cells)
    own = features.copy()
    own[:, :, 0] = features[:, :, 0].mean(axis=0)
    scores = curve.joined(own, n)[:, :, 0]
    what = "threshold" if question.paradigm == "threshold" else "equal strength"
    labels = [f"{one}, {name}" for one in (what, "JND") for name in names]
    tests = labels[: len(names)]
    if question.paradigm == "threshold":  # no single threshold is tested, but differences
        scores = scores[:, :1] - scores[:, 1:]
        tests = [f"{names[0]} over {name}" for name in names[1:]]

    def statistic(mean: FloatArray) -> FloatArray:
        return curve.joined(mean, n).swapaxes(1, 2).reshape(len(mean), -1)

    return Measured(labels, features, scores, tests, statistic)


def _identification(question: Question, names: list[str], people: Sequence[Answered]) -> Measured:
    sounds = list(question.stimuli)
    confusion = np.zeros((len(people), len(names), len(sounds), len(sounds)))
    for k, rows in enumerate(people):
        for row in rows:
            at = sounds.index(row["stimulus"]), sounds.index(row["answer"])
            confusion[k, names.index(row["condition_1"]), *at] += 1.0
    right = np.trace(confusion, axis1=2, axis2=3) / confusion.sum(axis=(2, 3))
    labels = [f"{what}, {name}" for what in ("right", "bits") for name in names]
    tests = [f"{label}, over chance" for label in labels[: len(names)]]
    return Measured(labels, confusion, right - 1.0 / len(sounds), tests, information, low=0.0)


def information(confusion: FloatArray) -> FloatArray:
    """Return shares of right answers and mutual information in bits, (draws, 2 x conditions).

    confusion: answers, (draws, conditions, sounds played, sounds answered).
    """
    p = confusion / confusion.sum(axis=(-2, -1), keepdims=True)
    entropies = [-xlogy(q, q).sum(axis=-1) for q in (p.sum(axis=-1), p.sum(axis=-2))]
    bits = (sum(entropies) + xlogy(p, p).sum(axis=(-2, -1))) / np.log(2.0)
    return np.concatenate([np.trace(p, axis1=-2, axis2=-1), bits], axis=-1)


_MEASURES = {
    "preference": _preference,
    "rating": _rating,
    "synchrony": _synchrony,
    "threshold": _levels,
    "equal": _levels,
    "identification": _identification,
}

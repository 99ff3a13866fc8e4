"""Psychometric functions on a grid of their parameters: the estimate, and the next best level.

The place x of a trial is a delay in ms or a level in dB. The answer that is counted is "yes, at the
same time", "the sound was first", "the right interval" or "the tested one was stronger". Each
parameter of the grid has equal prior weight (widths: equal for equal ratios). The next level is the
one with the least expected entropy, the rule of QUEST+ (Watson, Journal of Vision 17, 2017).
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtr, softmax, xlogy

from audioflinger_hook.study.design import Question
from device.units import FloatArray

HALF, QUARTILE = 1.177410, 0.674490  # of a normal density half its height, of its area 75 %
LAPSES = (0.0, 0.02, 0.06)

Counts = dict[tuple[str, str], FloatArray]
"""Counts of (yes, no) at each place, (2, xs), by tested condition and sound."""


def probability(
    question: Question, x: FloatArray, place: FloatArray, jnd: FloatArray
) -> FloatArray:
    """Return the probability of the counted answer without lapses.

    x, place, jnd: of any shapes that fit together, in ms for synchrony and in dB for levels. For
    simultaneity, place is the point of subjective simultaneity, and place - jnd and place + jnd are
    where half of the answers are yes. For order, jnd is from 50 to 75 %. For levels, jnd is the
    standard deviation of the decision, and place is answered with 75 % (threshold) or 50 %.
    """
    if question.paradigm == "synchrony" and question.judgement == "simultaneity":
        return np.asarray(np.exp(-0.5 * (HALF * (x - place) / jnd) ** 2))
    scale = QUARTILE if question.paradigm == "synchrony" else 1.0
    share = np.asarray(ndtr(scale * (x - place) / jnd))
    return 0.5 + 0.5 * share if question.paradigm == "threshold" else share


def tested(row: Mapping[str, Any], question: Question) -> int:
    """Return which interval of a trial has the tested condition, 1 or 2."""
    return 1 + (question.is_adaptive and row["condition_1"] == question.pairs[0][1])


def place(row: Mapping[str, Any], question: Question) -> tuple[float, str]:
    """Return the place x of a trial, and the answer that is counted."""
    if question.is_adaptive:
        return row[f"gain_db_{tested(row, question)}"], str(tested(row, question))
    return row["offset_ms"], question.kind["choices"][0]


class Curve:
    """The grid of a question. places: locations. widths: JNDs. xs: places of the trials.

    widths_db: number of JNDs for levels; few are enough to choose the next level.
    """

    def __init__(self, question: Question, widths_db: int = 7) -> None:
        self._question = question
        if question.is_adaptive:
            self.xs = np.arange(question.lowest_db, question.highest_db + 0.5)
            self.places, self.widths = self.xs, np.geomspace(0.4, 8.0, widths_db)
        else:
            self.xs = np.array(sorted(question.offsets_ms))
            self.places, self.widths = np.linspace(-150, 150, 76), np.geomspace(8, 400, 40)
        grid = np.meshgrid(self.places, self.widths, LAPSES, indexing="ij")
        self._place, self._width, lapse = (axis.ravel() for axis in grid)
        p = probability(question, self.xs[:, None], self._place, self._width)
        self._p = np.clip(0.5 * lapse + (1.0 - lapse) * p, 1e-6, 1.0 - 1e-6)
        self._log_yes, self._log_no = np.log(self._p), np.log1p(-self._p)
        self._entropy = xlogy(self._p, self._p) + xlogy(1.0 - self._p, 1.0 - self._p)

    def counts(self, rows: Iterable[Mapping[str, Any]], found: Counts | None = None) -> Counts:
        """Return counts of recorded rows, added to those in `found`."""
        found = {} if found is None else found
        for row in rows:
            x, counted = place(row, self._question)
            key = row[f"condition_{tested(row, self._question)}"], row["stimulus"]
            one = found.setdefault(key, np.zeros((2, len(self.xs))))
            one[int(row["answer"] != counted), np.argmin(np.abs(self.xs - x))] += 1.0
        return found

    def estimate(self, yes: FloatArray, no: FloatArray) -> FloatArray:
        """Return the means of place and width (in logarithms), (2,), for counts, (xs,)."""
        weight = softmax(yes @ self._log_yes + no @ self._log_no)
        return np.array([weight @ self._place, np.exp(weight @ np.log(self._width))])

    def given_width(self, yes: FloatArray, no: FloatArray) -> FloatArray:
        """Return log likelihood and mean of the place for each width and lapse, (2, cells)."""
        log = (yes @ self._log_yes + no @ self._log_no).reshape(len(self.places), -1)
        total = logsumexp(log, axis=0)
        return np.stack([total, self.places @ np.exp(log - total)])

    def joined(self, given: FloatArray, people: int) -> FloatArray:
        """Return place and width, (..., 2), if all people have one width and lapse.

        given: means over people of what `given_width` returns, (..., 2, cells).
        """
        weight = softmax(people * given[..., 0, :], axis=-1)
        log_widths = np.repeat(np.log(self.widths), len(LAPSES))
        where = (weight * given[..., 1, :]).sum(axis=-1)
        return np.stack([where, np.exp(weight @ log_widths)], axis=-1)

    def next_x(self, yes: FloatArray, no: FloatArray) -> float:
        """Return the place at which the next answer tells most. yes, no: counts, (xs,)."""
        weight = softmax(yes @ self._log_yes + no @ self._log_no)
        p = self._p @ weight
        told = self._entropy @ weight - (xlogy(p, p) + xlogy(1.0 - p, 1.0 - p))
        return float(self.xs[int(np.argmax(told))])

"""Psychometric functions on a grid of their parameters: the estimate, and the next best level.

The place x of a trial is a delay in ms or a level in dB. Each place of the grid has equal prior
weight, and each width for equal ratios. The next level is the one with the least expected entropy,
the rule of QUEST+ (Watson, Journal of Vision 17, 2017).
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtr, softmax, xlogy

from audioflinger_hook.study.design import Question
from device.units import FloatArray

HALF, QUARTILE = 1.177410, 0.674490  # of a normal density half its height, of its area 75 %
LAPSES = (0.0, 0.02, 0.06)


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

        given: means over people of what `given_width` returns, (2, ..., cells).
        """
        weight = softmax(people * given[0], axis=-1)
        place = (weight * given[1]).sum(axis=-1)
        return np.stack([place, np.exp(weight @ self._log_widths)])

    def next_x(self, counts: FloatArray) -> float:
        """Return the place at which the next answer tells most. counts: of one kind, (xs, 2)."""
        weight = softmax(np.tensordot(counts, self._log_p, 2))
        p = np.tensordot(self._p, weight, 2)  # (xs, 2)
        told = np.tensordot(self._entropy, weight, 2) - xlogy(p, p)
        return float(self.xs[int(np.argmax(told.sum(axis=1)))])

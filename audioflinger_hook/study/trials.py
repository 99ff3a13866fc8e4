"""The trials of a participant: their order and sides are balanced exactly, then shuffled.

A trial is the part of a row of the record that is known before its answer. `built_in/codebook.md`
describes the columns.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from audioflinger_hook.study.curves import Counts, Curve, tested
from audioflinger_hook.study.design import Design, Question

PRACTICE_BELOW_DB = 2.0  # level of adaptive practice trials, below the strongest


def session(design: Design, participant: int) -> list[dict[str, Any]]:
    """Return all trials of a participant in their order, practice included.

    participant: number of the participant, from 0. Equal numbers give equal trials. The questions
    rotate from participant to participant. For each pair of conditions and each sound, each
    condition comes first in half of the trials, and each answer is on the left in half of them.
    """
    names, rows = list(design.questions), list[dict[str, Any]]()
    turn = participant % len(names)
    for name in names[turn:] + names[:turn]:
        rng = np.random.default_rng((design.study.seed, participant, names.index(name)))
        kinds = balanced(design.questions[name], participant)
        kinds = [kinds[i] for i in rng.permutation(len(kinds))]
        rows += [kinds[i % len(kinds)] | {"practice": True} for i in range(design.study.practice)]
        rows += kinds
    done = 0
    for number, row in enumerate(rows, 1):
        row |= {"trial": number, "block": 1 + done // design.study.block}
        done += not row["practice"]
    return rows


def balanced(question: Question, participant: int) -> list[dict[str, Any]]:
    """Return a participant's trials of one question, not shuffled."""
    delays = question.offsets_ms if question.paradigm == "synchrony" else (0.0,)
    sounds, rows = list(question.stimuli), []
    turn = participant % len(sounds)
    for (s, sound), pair, offset_ms, repeat in product(
        enumerate(sounds), question.pairs, delays, range(question.repeats)
    ):
        conditions, choices = [name for name in pair if name], [*question.kind["choices"]]
        if question.kind["is_balanced"]:
            # Over two repeats, order and side take both values; over four, all combinations come.
            order, side = repeat % 2, (repeat + repeat // 2 + participant + s) % 2
            conditions, choices = conditions[:: 1 - 2 * order], choices[:: 1 - 2 * side]
        elif question.paradigm == "identification":
            choices = sounds[turn:] + sounds[:turn]
        what = {"question": question.name, "paradigm": question.paradigm, "practice": False}
        row = what | {"stimulus": sound, "choices": choices, "offset_ms": offset_ms}
        for i, condition in enumerate(conditions, 1):
            row |= {f"condition_{i}": condition, f"gain_db_{i}": 0.0}
        rows.append(row)
    return rows


class Script:
    """Chooses the trials of a participant, by number: a `Script` of `trials.record`."""

    def __init__(self, design: Design, number: int) -> None:
        self._design, self._left = design, session(design, number)[::-1]
        adaptive = [one for one in design.questions.values() if one.is_adaptive]
        self._curves = {question.name: (Curve(question), Counts()) for question in adaptive}

    def next_trial(self) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return the next trial, at the level that tells most, twice; None at the end."""
        if not self._left:
            return None
        row = self._left[-1]
        if row["question"] in self._curves:
            question = self._design.questions[row["question"]]
            (curve, counts), place = self._curves[question.name], tested(row, question)
            level_db = question.highest_db - PRACTICE_BELOW_DB
            if not row["practice"]:
                none = np.zeros((2, len(curve.xs)))
                key = row[f"condition_{place}"], row["stimulus"]
                level_db = curve.next_x(*counts.get(key, none))
            row = row | {f"gain_db_{place}": level_db}
        return row, row

    def take(self, row: Mapping[str, Any]) -> None:
        """Count a recorded answer."""
        self._left.pop()
        if row["question"] in self._curves and not row["practice"]:
            curve, counts = self._curves[row["question"]]
            curve.counts([row], counts)

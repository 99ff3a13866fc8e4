"""A participant's session: trials whose order and sides are balanced exactly, and their answers.

A trial is the part of a row of the record that is known before its answer. `built_in/codebook.md`
describes the columns.
"""

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.study.design import Design, Question
from audioflinger_hook.study.measure import Curve, count
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.trials.page import AGAIN, Choice, screen
from audioflinger_hook.trials.person import Person

PRACTICE_BELOW_DB = 2.0  # level of adaptive practice trials, below the strongest
LABELS = {"1": "First", "2": "Second"}


def session(design: Design, participant: int) -> list[dict[str, Any]]:
    """Return all trials of a participant in their order, practice included.

    participant: number of the participant, from 0. Equal numbers give equal trials. The questions
    rotate from participant to participant. For each pair of conditions and each sound, each
    condition comes first in half of the trials, and each answer is on the left in half of them.
    """
    names, rows = list(design.questions), list[dict[str, Any]]()
    turn, done = participant % len(names), 0
    for name in names[turn:] + names[:turn]:
        rng = np.random.default_rng((design.study.seed, participant, names.index(name)))
        kinds = rng.permutation(np.array(balanced(design.questions[name], participant)))
        rows += [{**kinds[i % len(kinds)], "practice": True} for i in range(design.study.practice)]
        rows += [{**kind, "practice": False} for kind in kinds]
    for number, row in enumerate(rows, 1):
        row |= {"trial": number, "block": 1 + done // design.study.block}
        done += not row["practice"]
    return rows


def balanced(question: Question, participant: int) -> list[dict[str, Any]]:
    """Return a participant's trials of one question, not shuffled."""
    sounds, kind, rows = list(question.stimuli), question.kind, []
    turn = participant % len(sounds)
    own = sounds[turn:] + sounds[:turn] if question.paradigm == "identification" else []
    for (s, sound), (tested, against), varied, repeat in product(
        enumerate(sounds), question.pairs, question.delays, range(question.repeats)
    ):
        intervals, choices = [name for name in (against, tested) if name], own + kind["choices"]
        if kind["is_balanced"]:
            # Over two repeats, order and side take both values; over four, all combinations come.
            order, side = repeat % 2, (repeat + repeat // 2 + participant + s) % 2
            intervals, choices = intervals[:: 1 - 2 * order], choices[:: 1 - 2 * side]
        row = {"question": question.name, "paradigm": question.paradigm, "stimulus": sound}
        row |= {f"condition_{i}": name for i, name in enumerate(intervals, 1)}
        row |= {"tested": tested, "against": against, "varied": varied, "choices": choices}
        counted = str(1 + intervals.index(tested))
        if len(intervals) == 1:
            counted = sound if own else kind["choices"][0]
        rows.append(row | {"counted": counted})
    return rows


class Script:
    """Chooses the trials of a participant, by number: a `Script` of `trials.session`."""

    def __init__(self, design: Design, number: int) -> None:
        self._design, self._left = design, session(design, number)[::-1]
        adaptive = [one for one in design.questions.values() if one.kind["varies"] == "level"]
        self._curves = {one.name: Curve(one) for one in adaptive}
        self._counts = {name: count([], curve.axes) for name, curve in self._curves.items()}

    def next_trial(self) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return the next trial, at its most informative level, twice; None at the end."""
        if not self._left:
            return None
        row = self._left[-1]
        if curve := self._curves.get(row["question"]):
            at = [curve.axes[key].index(row[key]) for key in ("tested", "stimulus")]
            varied = self._design.questions[row["question"]].highest_db - PRACTICE_BELOW_DB
            if not row["practice"]:
                varied = curve.next_x(self._counts[row["question"]][*at])
            row = row | {"varied": varied}
        return row, row

    def take(self, row: Mapping[str, Any]) -> None:
        """Count a recorded answer."""
        self._left.pop()
        if row["question"] in self._curves and not row["practice"]:
            self._counts[row["question"]] += count([row], self._curves[row["question"]].axes)


class Participant:
    """A person, to whom trials are played. total: number of the session's trials."""

    def __init__(self, person: Person, stimuli: Stimuli, total: int) -> None:
        self._person, self._stimuli, self._total = person, stimuli, total

    def read(self, title: str, text: str, *choices: Choice) -> str | float:
        """Show a text; return the button that is pressed."""
        shown = screen("text", title, *text.strip().split("\n\n"), choices=choices)
        return self._person.answers.ask(shown).value

    def pause(self) -> None:
        """Show a pause until the person goes on."""
        self.read("Pause", "Take a pause. Go on when you are ready.", ("on", "Go on", "1"))

    def answer(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Play all intervals, as often as the person asks; return columns of playing and answer."""
        question, made = self._stimuli.design.questions[row["question"]], self._stimuli.of(row)
        kind, title = question.kind, question.ask or question.kind["ask"]
        about = {"done": row["trial"] - 1, "total": self._total, "practice": row["practice"]}
        labels = [LABELS.get(choice, Path(choice).stem.capitalize()) for choice in row["choices"]]
        order = kind["choices"] or row["choices"]  # an answer has one key on either side
        keys = [str(1 + order.index(choice)) for choice in row["choices"]]
        choices = [*zip(row["choices"], labels, keys, strict=True)]
        more = {"choices": choices, "also": [AGAIN], "labels": kind.get("labels", ())}
        titles = [*LABELS.values()] if len(made) > 1 else [title]
        shown = [screen("playing", name, **about) for name in titles]
        intervals = [(one.sound, one.vibration, now) for one, now in zip(made, shown, strict=True)]
        asked = screen(kind["screen"], title, **more, **about)
        played, answered = self._person.answer(lambda: intervals, asked)
        for number, (one, measured) in enumerate(zip(made, played, strict=True), 1):
            columns = {**one.columns, **vars(measured)}
            answered |= {f"{key}_{number}": value for key, value in columns.items()}
        return answered

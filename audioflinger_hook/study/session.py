"""A participant's session: plays each trial, asks, and records the answer before the next trial."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from audioflinger_hook.study.curves import Curve
from audioflinger_hook.study.design import ADAPTIVE, GAP_S, Design, Question
from audioflinger_hook.study.people import People
from audioflinger_hook.study.stimuli import Stimuli, Vibration
from audioflinger_hook.study.trials import Trial, at_level, counted, session, tested
from audioflinger_hook.trials import page
from audioflinger_hook.trials.player import Played, Player
from device.units import FloatArray

PRACTICE_BELOW_DB = 2.0  # level of adaptive practice trials, below the strongest
ASKED = {
    "preference": "Which vibration fits the sound better?",
    "rating": "How well does the second vibration fit, if the first one fits perfectly?",
    "simultaneity": "Were sound and vibration simultaneous?",
    "order": "Which came first?",
    "threshold": "In which interval did you feel a vibration?",
    "equal": "Which vibration was stronger?",
    "identification": "Which sound was it?",
}
LABELS = {"1": "First", "2": "Second", "yes": "Yes", "no": "No"}
PAUSE = "Take a pause. Go on when you are ready."
THANKS = "This was the last question. Thank you for taking part."


class _Record(Protocol):
    trials: list[dict[str, Any]]

    def append(self, trial: Mapping[str, Any]) -> None: ...


class _Participant(Protocol):
    def answer(self, trial: Trial, question: Question, files: list[Vibration]) -> dict[str, Any]:
        """Play a trial and ask; return the columns of what was played and answered."""
        ...

    def pause(self) -> None: ...


def run(
    design: Design, number: int, record: _Record, stimuli: Stimuli | None, who: _Participant
) -> Iterator[Trial]:
    """Yield each trial after its row is recorded; trials that are recorded already are left out.

    number: the participant's, from 0. record: has `trials`, and `append`, as `TrialRecord`.
    stimuli: makes the files; None for a simulation without. who: a `Person` or `Simulated`.
    """
    counts: dict[tuple[str, str, str], FloatArray] = {}
    curves = {name: Curve(q) for name, q in design.questions.items() if q.paradigm in ADAPTIVE}
    done = {row["trial"]: row for row in record.trials}
    block = max([row["block"] for row in record.trials], default=1)
    for trial in session(design, number):
        question, curve = design.questions[trial.question], curves.get(trial.question)
        row = done.get(trial.number)
        if row is None and trial.block > block:
            who.pause()
            block = trial.block
        if curve:
            key = trial.question, trial.conditions[tested(trial, question)], trial.stimulus
            before = counts.setdefault(key, np.zeros((2, len(curve.xs))))
            level_db = question.highest_db - PRACTICE_BELOW_DB
            if row is None and not trial.is_practice:
                level_db = curve.next_x(*before)
            trial = at_level(trial, question, level_db)
        if row is None:
            row = _columns(trial, question)
            intervals = range(len(trial.conditions) if stimuli else 0)
            files = [stimuli.vibration(trial, i) for i in intervals] if stimuli else []
            row |= who.answer(trial, question, files)
            record.append(row)
            yield trial
        if curve and not trial.is_practice:
            x = row[f"gain_db_{1 + tested(trial, question)}"]
            before[int(not counted(trial, question, row["answer"])), curve.index(x)] += 1.0


def _columns(trial: Trial, question: Question) -> dict[str, Any]:
    columns = {
        "trial": trial.number,
        "question": trial.question,
        "paradigm": question.paradigm,
        "block": trial.block,
        "practice": trial.is_practice,
        "stimulus": trial.stimulus,
        "choices": list(trial.choices),
        "offset_ms": trial.offset_ms,
    }
    for i, condition in enumerate(trial.conditions):
        columns |= {f"condition_{i + 1}": condition, f"gain_db_{i + 1}": trial.gains_db[i]}
    return columns


def trial_of(row: Mapping[str, Any]) -> Trial:
    """Return the trial of a recorded row."""
    places = [i for i in (1, 2) if f"condition_{i}" in row]
    conditions = tuple(row[f"condition_{i}"] for i in places)
    gains_db = tuple(row[f"gain_db_{i}"] for i in places)
    where = row["trial"], row["block"], row["practice"]
    what = row["question"], row["stimulus"], conditions, tuple(row["choices"])
    return Trial(*what, row["offset_ms"], gains_db, *where)


def _played(i: int, file: Vibration, played: Played) -> dict[str, Any]:
    """Return the columns of what interval i played. JSON has null for the level of silence."""
    measured = {"vibration_sha256": file.digest, "weighted_db": file.weighted_db, **vars(played)}
    return {
        f"{key}_{i + 1}": None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in measured.items()
    }


class Person:
    """A person, who answers on a page, and a player of the vibration.

    total: number of the session's trials.
    """

    def __init__(self, answers: page.Answers, player: Player, total: int) -> None:
        self._answers, self._player, self._total = answers, player, total

    def agrees(self, consent: str) -> bool:
        """Ask for consent; return whether it is given."""
        choices = page.Choice("yes", "I agree", "1"), page.Choice("no", "I do not agree", "2")
        return self._answers.ask(self._text("Consent", consent, choices)).value == "yes"

    def pause(self) -> None:
        """Show a pause until the person goes on."""
        self._answers.ask(self._text("Pause", PAUSE, (page.Choice("on", "Go on", "1"),)))

    def answer(self, trial: Trial, question: Question, files: list[Vibration]) -> dict[str, Any]:
        """Play all intervals, as often as the person asks, and return the answer."""
        asked = self._asked(trial, question)
        columns: dict[str, Any] = {}
        again = 0
        while True:
            for i, file in enumerate(files):
                title = LABELS[str(i + 1)] if len(files) > 1 else asked.title
                screen = replace(asked, kind=page.Kind.PLAYING, title=title, choices=(), also=())
                where = file.sound, file.path
                played = page.play_whole(self._player, self._answers, where, screen)
                columns |= _played(i, file, played)
            given = self._answers.ask(asked)
            if given.value != page.AGAIN.value:
                break
            again += 1
        about = {"answered_after_s": given.after_s, "again": again, "pauses": given.pauses}
        return {**columns, "answer": given.value, **about}

    def thank(self) -> None:
        """Show that the session is over."""
        self._answers.show(self._text("The end", THANKS, ()))

    def _asked(self, trial: Trial, question: Question) -> page.Question:
        key = question.judgement if question.paradigm == "synchrony" else question.paradigm
        kind = page.Kind.ONE_OF if question.paradigm == "identification" else page.Kind.CHOICE
        labelled = [(choice, LABELS.get(choice, choice.capitalize())) for choice in trial.choices]
        return page.Question(
            page.Kind.SLIDER if question.paradigm == "rating" else kind,
            question.ask or ASKED[key],
            choices=tuple(page.Choice(*one, str(i)) for i, one in enumerate(labelled, 1)),
            also=(page.AGAIN,),
            labels=("bad", "fair", "excellent") if question.paradigm == "rating" else (),
            done=trial.number - 1,
            total=self._total,
            practice=trial.is_practice,
        )

    def _text(self, title: str, text: str, choices: tuple[page.Choice, ...]) -> page.Question:
        paragraphs = tuple(text.strip().split("\n\n"))
        return page.Question(page.Kind.TEXT, title, paragraphs, choices)


class Simulated:
    """A simulated person, and a player without a device, whose clock only counts.

    rows: what is recorded already, so that the clock goes on.
    """

    def __init__(self, people: People, number: int, rows: Sequence[Mapping[str, Any]] = ()) -> None:
        self._people, self._number, self._now_s = people, number, 0.0
        for row in rows[-1:]:
            last = 2 if "condition_2" in row else 1
            began_s = row[f"vibration_began_s_{last}"] + row[f"seconds_{last}"] + GAP_S
            self._now_s = began_s + row["answered_after_s"]

    def pause(self) -> None:
        """Take no pause."""

    def answer(self, trial: Trial, question: Question, files: list[Vibration]) -> dict[str, Any]:
        """Return a random answer, and what a perfect device would have played."""
        columns: dict[str, Any] = {}
        for i, file in enumerate(files):
            began_s = self._now_s if file.sound else None
            levels = file.peak_dbfs, file.level_dbfs
            played = Played(began_s, self._now_s, file.seconds, False, *levels, 0.0, 0, None, None)
            columns |= _played(i, file, played)
            self._now_s += file.seconds + GAP_S
        answer, after_s = self._people.answer(trial, self._number)
        self._now_s += after_s
        about = {"answered_after_s": after_s, "again": 0, "pauses": 0}
        return {**columns, "answer": answer, **about}

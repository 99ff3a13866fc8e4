"""A participant's session: plays each trial, asks, and records the answer before the next trial."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from audioflinger_hook.study.curves import Curve
from audioflinger_hook.study.design import ADAPTIVE, GAP_S, Design, Question
from audioflinger_hook.study.people import People
from audioflinger_hook.study.stimuli import Stimuli, Vibration
from audioflinger_hook.study.trials import Trial, at_level, counted, session, tested
from audioflinger_hook.trials import page
from audioflinger_hook.trials import session as trials_session
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import Played
from audioflinger_hook.trials.record import Rows
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


class _Script:
    """Chooses a participant's trials: a `Script` of `trials.session`."""

    def __init__(self, design: Design, number: int) -> None:
        self._design, self._left = design, session(design, number)[::-1]
        adaptive = [one for one in design.questions.values() if one.paradigm in ADAPTIVE]
        self._curves = {question.name: Curve(question) for question in adaptive}
        self._counts: dict[tuple[str, str, str], FloatArray] = {}

    def next_trial(self) -> tuple[Trial, dict[str, Any]] | None:
        """Return the next trial, at the level that tells most, and its columns."""
        if not self._left:
            return None
        trial = self._left[-1]
        question = self._design.questions[trial.question]
        if curve := self._curves.get(trial.question):
            level_db = question.highest_db - PRACTICE_BELOW_DB
            if not trial.is_practice:
                level_db = curve.next_x(*self._counted(trial, question))
            trial = at_level(trial, question, level_db)
        return trial, _columns(trial, question)

    def take(self, row: Mapping[str, Any]) -> None:
        """Count a recorded answer."""
        self._left.pop()
        trial, question = trial_of(row), self._design.questions[row["question"]]
        if (curve := self._curves.get(question.name)) and not trial.is_practice:
            is_other = not counted(trial, question, row["answer"])
            x = trial.gains_db[tested(trial, question)]
            self._counted(trial, question)[int(is_other), curve.index(x)] += 1.0

    def _counted(self, trial: Trial, question: Question) -> FloatArray:
        key = trial.question, trial.conditions[tested(trial, question)], trial.stimulus
        return self._counts.setdefault(key, np.zeros((2, len(self._curves[trial.question].xs))))


class Participant(Protocol):
    """Who answers: a `StudyPerson` or `Simulated`."""

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial and ask; return the columns of what was played and answered."""
        ...

    def pause(self) -> None:
        """Take a pause."""
        ...


def run(design: Design, number: int, record: Rows, who: Participant) -> Iterator[Mapping[str, Any]]:
    """Yield each row after it is recorded; trials that are recorded already are left out.

    number: the participant's, from 0.
    """
    return trials_session.run(record, _Script(design, number), who.answer, who.pause)


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


class StudyPerson:
    """A person, who feels and answers.

    stimuli: makes the files. total: number of the session's trials.
    """

    def __init__(self, person: Person, stimuli: Stimuli, total: int) -> None:
        self._person, self._stimuli, self._total = person, stimuli, total

    def agrees(self, consent: str) -> bool:
        """Ask for consent; return whether it is given."""
        choices = ("yes", "I agree", "1"), ("no", "I do not agree", "2")
        return self._person.answers.ask(_text("Consent", consent, *choices)).value == "yes"

    def pause(self) -> None:
        """Show a pause until the person goes on."""
        self._person.answers.ask(_text("Pause", PAUSE, ("on", "Go on", "1")))

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play all intervals, as often as the person asks, and return the answer."""
        asked = self._asked(trial, self._stimuli.design.questions[trial.question])
        files = self._stimuli.of(trial)
        shown = {**asked, "kind": "playing", "choices": [], "also": []}
        titles = [LABELS["1"], LABELS["2"]] if len(files) > 1 else [asked["title"]]
        intervals = [
            (file.sound, file.path, {**shown, "title": title})
            for file, title in zip(files, titles, strict=True)
        ]
        played, columns = self._person.answer(lambda: intervals, asked)
        for i, (file, one) in enumerate(zip(files, played, strict=True)):
            columns |= _played(i, file, one)
        return columns

    def thank(self) -> None:
        """Show that the session is over."""
        self._person.answers.show(_text("The end", THANKS))

    def _asked(self, trial: Trial, question: Question) -> page.Screen:
        key = question.judgement if question.paradigm == "synchrony" else question.paradigm
        kind: page.Kind = "one of" if question.paradigm == "identification" else "choice"
        labelled = [(choice, LABELS.get(choice, choice.capitalize())) for choice in trial.choices]
        is_rating = question.paradigm == "rating"
        return page.screen(
            "slider" if is_rating else kind,
            question.ask or ASKED[key],
            choices=[(*one, str(i)) for i, one in enumerate(labelled, 1)],
            also=[page.AGAIN],
            labels=("bad", "fair", "excellent") if is_rating else (),
            done=trial.number - 1,
            total=self._total,
            practice=trial.is_practice,
        )


def _text(title: str, text: str, *choices: page.Choice) -> page.Screen:
    return page.screen("text", title, *text.strip().split("\n\n"), choices=choices)


class Simulated:
    """A simulated person, and a player without a device, whose clock only counts.

    stimuli: makes the files; None for none. rows: what is recorded already, so that the clock goes
    on.
    """

    def __init__(
        self,
        people: People,
        number: int,
        stimuli: Stimuli | None = None,
        rows: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        self._people, self._number, self._now_s = people, number, 0.0
        self._stimuli = stimuli
        for row in rows[-1:]:
            last = 2 if "condition_2" in row else 1
            began_s = row[f"vibration_began_s_{last}"] + row[f"seconds_{last}"] + GAP_S
            self._now_s = began_s + row["answered_after_s"]

    def pause(self) -> None:
        """Take no pause."""

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Return a random answer, and what a perfect device would have played."""
        columns: dict[str, Any] = {}
        for i, file in enumerate(self._stimuli.of(trial) if self._stimuli else []):
            began_s = self._now_s if file.sound else None
            level = file.level_dbfs
            played = Played(began_s, self._now_s, file.seconds, False, level, 0.0, None, None)
            columns |= _played(i, file, played)
            self._now_s += file.seconds + GAP_S
        answer, after_s = self._people.answer(trial, self._number)
        self._now_s += after_s
        about = {"answered_after_s": after_s, "again": 0, "pauses": 0}
        return {**columns, "answer": answer, **about}

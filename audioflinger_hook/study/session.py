"""A participant's session: plays each trial, asks, and records the answer before the next trial."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from audioflinger_hook.study.curves import Curve
from audioflinger_hook.study.design import ADAPTIVE, GAP_S, Design, Question
from audioflinger_hook.study.people import People
from audioflinger_hook.study.stimuli import Stimuli, Vibration
from audioflinger_hook.study.trials import Trial, at_level, counted, session, tested
from audioflinger_hook.trials.player import Played
from device.units import FloatArray

PRACTICE_BELOW_DB = 2.0  # level of adaptive practice trials, below the strongest


class Record(Protocol):
    """Where the rows of a session are kept, such as `audioflinger_hook.trials.TrialRecord`."""

    trials: list[dict[str, Any]]

    def append(self, trial: Mapping[str, Any]) -> None:
        """Keep one row."""
        ...


class Participant(Protocol):
    """Who answers: a person at the page (`study.live`), or a simulated one."""

    def pause(self, done: int, total: int) -> None:
        """Offer a pause between two blocks. done, total: trials."""
        ...

    def answer(
        self, trial: Trial, question: Question, play: Callable[[int], Played], progress: float
    ) -> dict[str, Any]:
        """Return `answer`, `answered_after_s`, `again` and `pauses` of a trial.

        play: plays an interval, 0 or 1, and returns what was played; the caller keeps the last of
        each. progress: share of the session that is done.
        """
        ...


def run(
    design: Design, number: int, record: Record, stimuli: Stimuli | None, play: Any, who: Any
) -> Iterator[Trial]:
    """Yield each trial after its row is recorded; trials that are recorded already are left out.

    number: the participant's, from 0. stimuli: files of the trials; None for a simulation without
    files. play: function of a `Vibration` that returns `Played`; it may repeat lost trials.
    """
    trials = session(design, number)
    states: dict[tuple[str, str, str], FloatArray] = {}
    curves = {name: Curve(q) for name, q in design.questions.items() if q.paradigm in ADAPTIVE}
    done = {row["trial"]: row for row in record.trials}
    block = 1
    for trial in trials:
        question = design.questions[trial.question]
        if trial.number not in done and trial.block > block and record.trials:
            who.pause(len(record.trials), len(trials))
        block = trial.block
        key = _key(trial, question)
        if question.name in curves:
            curve = curves[question.name]
            counts = states.setdefault(key, np.zeros((2, len(curve.xs))))
            level_db = question.highest_db - PRACTICE_BELOW_DB
            if not trial.is_practice and trial.number not in done:
                level_db = curve.next_x(*counts)
            trial = at_level(trial, question, level_db)
        if (row := done.get(trial.number)) is None:
            row = _row(design, number, trial, question, stimuli, play, who, len(trials))
            record.append(row)
            yield trial
        if question.name in curves and not trial.is_practice:
            x = row[f"gain_db_{1 + tested(trial, question)}"]
            states[key][int(not counted(trial, question, row["answer"])), curve.index(x)] += 1.0


def _key(trial: Trial, question: Question) -> tuple[str, str, str]:
    place = tested(trial, question) if question.paradigm in ADAPTIVE else 0
    return trial.question, trial.conditions[place], trial.stimulus


def _row(
    design: Design,
    number: int,
    trial: Trial,
    question: Question,
    stimuli: Stimuli | None,
    play: Any,
    who: Any,
    total: int,
) -> dict[str, Any]:
    row: dict[str, Any] = {
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
        row |= {f"condition_{i + 1}": condition, f"gain_db_{i + 1}": trial.gains_db[i]}
    if stimuli is None:
        return row | who.answer(trial, question, None, 0.0)
    files = [stimuli.vibration(trial, i) for i in range(len(trial.conditions))]

    def play_one(i: int) -> Played:
        played: Played = play(files[i])
        row.update({f"{key}_{i + 1}": value for key, value in _measured(files[i], played).items()})
        return played

    return row | who.answer(trial, question, play_one, (trial.number - 1) / total)


def _measured(file: Vibration, played: Played) -> dict[str, Any]:
    finite = {key: None if value is None else float(value) for key, value in vars(played).items()}
    return {"vibration_sha256": file.digest, "weighted_db": file.weighted_db} | {
        key: value if value is None or np.isfinite(value) else None for key, value in finite.items()
    }


class Simulated:
    """A simulated participant, and a player without a device: a clock that only counts."""

    def __init__(self, people: People, number: int, now_s: float = 0.0) -> None:
        self._people, self._number, self._now_s = people, number, now_s

    def pause(self, done: int, total: int) -> None:
        """Take no pause."""

    def answer(self, trial: Trial, question: Question, play: Any, progress: float) -> dict[str, Any]:
        """Let each interval play once, and draw an answer."""
        for i in range(len(trial.conditions) if play else 0):
            play(i)
        answer, after_s = self._people.answer(trial, self._number)
        self._now_s += after_s
        return {"answer": answer, "answered_after_s": round(after_s, 3), "again": 0, "pauses": 0}

    def play(self, file: Vibration) -> Played:
        """Return what a perfect device would have played."""
        began_s = self._now_s
        self._now_s += file.seconds + GAP_S
        sound_s = began_s if file.sound else None
        levels = file.peak_dbfs, file.level_dbfs
        return Played(sound_s, began_s, file.seconds, False, *levels, 0.0, 0, None)

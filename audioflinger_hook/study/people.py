"""Simulated people, whose true parameters are known, and the power of a design with them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from audioflinger_hook.study.design import GAP_S, Design, Question
from audioflinger_hook.study.estimates import Measured, p_values
from audioflinger_hook.study.paradigms import chances, measure
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.study.trials import Script
from audioflinger_hook.trials.player import Played
from audioflinger_hook.trials.record import Rows, run
from audioflinger_hook.trials.simulated import drawn, people_file, with_lapses
from device.errors import UsageError
from device.units import FloatArray
from device.values import Described, Number, nearest

STUDIES, LEVEL = 100, 0.05


@dataclass(frozen=True)
class _File(Described):
    people: Annotated[int, Number("people", 1, 10_000, whole=True)]
    seed: Annotated[int, Number("seed", 0, 2**31, whole=True)] = 1


class People:
    """Draws people and their answers. The same seed, person and trial give the same answer.

    truths: the parameters of each question, by its name; other questions have the defaults of
    `paradigms.toml`. NAME_spread is the standard deviation between people, by default 0, and lapse
    the share of random answers. UsageError: a name or value is not allowed.
    """

    def __init__(self, design: Design, truths: Mapping[str, Any], seed: int, count: int) -> None:
        self.count, self.design, self.seed = count, design, seed
        _known("question", truths, design.questions)
        self.truths = {n: _parameters(q, truths.get(n, {})) for n, q in design.questions.items()}

    def person(self, name: str, number: int) -> dict[str, FloatArray]:
        """Return a person's parameters in a question, one value for each condition."""
        index = list(self.design.questions).index(name)
        return self.drawn(name, np.random.default_rng((self.seed, index, number)))

    def drawn(self, name: str, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Return the parameters of a random person in a question."""
        truth, person = self.truths[name], {"lapse": self.truths[name]["lapse"]}
        for key, (_, low, high) in self.design.questions[name].kind["parameters"].items():
            value = truth[key] + truth[f"{key}_spread"] * rng.standard_normal(truth[key].size)
            person[key] = np.clip(value, low, high)
        return person

    def answer(self, row: Mapping[str, Any], number: int) -> dict[str, Any]:
        """Return a person's answer to a trial, as columns."""
        question = self.design.questions[row["question"]]
        person = self.person(question.name, number)
        rng = np.random.default_rng((self.seed, number, row["trial"], 7))
        after_s, lapse = round(0.5 + float(rng.gamma(2.0, 0.6)), 3), float(person["lapse"][0])
        if row["choices"]:
            p = with_lapses(chances(question, row, person), lapse)
            answer = row["choices"][drawn(p, rng)]
        else:
            at = question.conditions.index(row["condition_2"])
            rated = person["rating"][at] + person["noise"][at] * rng.standard_normal()
            is_random = rng.random() < lapse
            answer = round(float(np.clip(100.0 * rng.random() if is_random else rated, 0, 100)))
        return {"answer": answer, "answered_after_s": after_s, "again": 0, "pauses": 0}


def load_people(path: Path, design: Design) -> People:
    """Return the people of a JSON file. UsageError: it cannot be read, or has a mistake."""
    document = people_file(path)
    try:
        truths = document.pop("questions", {})
        _known("key", document, ("people", "seed", "questions"))
        given = _File.from_values({"people": design.study.participants} | document)
        if given.people > design.study.participants:
            most = design.study.participants
            raise UsageError(f"people={given.people}, but the design ends after {most}")
        return People(design, truths, given.seed, given.people)
    except UsageError as error:
        raise UsageError(f"{path}: {error}; see docs/study.md") from None


def _known(what: str, given: Any, known: Iterable[str]) -> None:
    if not isinstance(given, dict):
        raise UsageError(f"{given!r} is not a JSON object with names of each {what}")
    for name in given.keys() - {*known}:
        guess = f"; did you mean {near}?" if (near := nearest(name, known)) else ""
        raise UsageError(f"{name!r} is an unknown {what}; allowed: {', '.join(known)}{guess}")


def _parameters(question: Question, truth: Any) -> dict[str, FloatArray]:
    """Return each parameter of a question, with one value for each condition."""
    own = question.kind["parameters"]
    spreads = {f"{key}_spread": (0.0, 0.0, 1e4) for key in own}
    known, found = {**own, **spreads, "lapse": (0.0, 0.0, 1.0)}, {}
    _known(f"parameter of {question.name}", truth, known)
    for key, (default, low, high) in known.items():
        given = truth.get(key, default)
        if isinstance(given, dict):
            _known(f"condition in {question.name}.{key}", given, question.conditions)
        else:
            given = dict.fromkeys(question.conditions, given)
        values: list[Any] = [given.get(name, default) for name in question.conditions]
        for value in values:
            if refusal := Number("", low, high).refuse(value):
                raise UsageError(f"{question.name}.{key}={value} {refusal}")
        found[key] = np.array(values, dtype=float)
    return found


class Simulated:
    """A simulated person, and a device without errors, whose clock only counts.

    number: of the person, from 0. stimuli: makes what is played; None for none. rows: what is
    recorded already, so that the clock goes on.
    """

    def __init__(
        self,
        people: People,
        number: int,
        stimuli: Stimuli | None = None,
        rows: Iterable[Mapping[str, Any]] = (),
    ) -> None:
        self._people, self._number, self._stimuli = people, number, stimuli
        self._now_s = 0.0
        for row in rows:
            last = 2 if "condition_2" in row else 1
            ended_s = row[f"vibration_began_s_{last}"] + row[f"seconds_{last}"]
            self._now_s = ended_s + GAP_S + row["answered_after_s"]

    def answer(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return a random answer, and what the device would have played."""
        columns: dict[str, Any] = {}
        for i, one in enumerate(self._stimuli.of(row) if self._stimuli else (), 1):
            now_s = None if one.sound is None else self._now_s
            what = now_s, self._now_s, one.seconds, False, one.level_dbfs, 0.0, None, None
            columns |= one.columns(i, Played(*what))
            self._now_s += one.seconds + GAP_S
        columns |= self._people.answer(row, self._number)
        self._now_s += columns["answered_after_s"]
        return columns


def simulated_study(design: Design, name: str, people: People) -> Measured:
    """Return what a study of one question with simulated people measures. No file is made."""
    alone, answered = replace(design, questions={name: design.questions[name]}), []
    for number in range(people.count):
        rows = run(Rows(), Script(alone, number), Simulated(people, number).answer)
        answered.append([row for row in rows if not row["practice"]])
    return measure(design.questions[name], answered)


def power(design: Design, question: Question, progress: Callable[[int, int], None]) -> float | None:
    """Return the share of simulated studies that find the question's `effect`; None without one.

    A study finds the effect if the test of all comparisons together gives p below 0.05. None also
    if there is no such test. progress: called with the studies done and in total.
    """
    if question.effect is None:
        return None
    alone = replace(design, questions={question.name: question})
    effect, count, found = {question.name: question.effect}, design.study.participants, []
    for seed in range(STUDIES):
        people = People(alone, effect, design.study.seed + seed, count)
        p, _ = p_values(simulated_study(alone, question.name, people))
        if p is None:
            return None
        found.append(p < LEVEL)
        progress(seed + 1, STUDIES)
    return float(np.mean(found))

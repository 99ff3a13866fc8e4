"""Simulated people, whose true parameters are known: `cushion study run --simulate PEOPLE.json`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.study.curves import probability
from audioflinger_hook.study.design import Design, Question
from audioflinger_hook.study.trials import FIRST, SECOND, Trial, counted
from audioflinger_hook.trials.simulated import drawn, people_file, with_lapses
from device.errors import UsageError
from device.units import FloatArray
from device.values import nearest

PARAMETERS: dict[str, dict[str, float]] = {
    "preference": {"worth": 0.0},
    "rating": {"rating": 50.0, "noise": 8.0},
    "synchrony": {"pss_ms": 0.0, "jnd_ms": 60.0},
    "threshold": {"threshold_db": -20.0, "jnd_db": 2.0},
    "equal": {"equal_db": 0.0, "jnd_db": 1.5},
    "identification": {"accuracy": 0.5},
}
"""The parameters of each paradigm, with their defaults. NAME_spread is the standard deviation
between people, by default 0, and lapse the share of random answers.
"""
LOWEST = {"jnd_ms": 5.0, "jnd_db": 0.2, "noise": 0.0, "accuracy": 0.0}


class People:
    """Draws people and their answers. The same seed, person and trial give the same answer.

    design: the study's. truths: the parameters of each question, by its name; other questions have
    the defaults. UsageError: a name or value is not allowed.
    """

    def __init__(self, design: Design, truths: Mapping[str, Any], seed: int, count: int) -> None:
        self.count, self.design, self._seed = count, design, seed
        self._truths: dict[str, dict[str, FloatArray]] = {}
        known = list(design.questions)
        for name in truths:
            if name not in known:
                raise UsageError(f"{name!r} is no question; {_allowed(name, known)}")
        for name, question in design.questions.items():
            self._truths[name] = _parameters(question, truths.get(name, {}))

    def person(self, name: str, person: int) -> dict[str, FloatArray]:
        """Return a person's parameters in a question, one value for each condition."""
        index = list(self.design.questions).index(name)
        return self._drawn(name, np.random.default_rng((self._seed, index, person)))

    def many(self, name: str, count: int = 4_000) -> list[dict[str, FloatArray]]:
        """Return the parameters of so many people. If all are equal, return those of one."""
        truth = self._truths[name]
        spread = any(truth[key].any() for key in truth if key.endswith("_spread"))
        rng = np.random.default_rng((self._seed, 1))
        return [self._drawn(name, rng) for _ in range(count if spread else 1)]

    def answer(self, trial: Trial, person: int) -> tuple[str | float, float]:
        """Return a person's answer to a trial, and after how many seconds it comes."""
        question = self.design.questions[trial.question]
        rng = np.random.default_rng((self._seed, person, trial.number, 7))
        return answer(question, trial, self.person(question.name, person), rng)

    def _drawn(self, name: str, rng: np.random.Generator) -> dict[str, FloatArray]:
        truth = self._truths[name]
        person = {"lapse": truth["lapse"]}
        for key in truth:
            if key != "lapse" and not key.endswith("_spread"):
                value = truth[key] + truth[f"{key}_spread"] * rng.standard_normal(truth[key].size)
                person[key] = np.maximum(value, LOWEST.get(key, -np.inf))
        return person


def load_people(path: Path, design: Design) -> People:
    """Return the people of a JSON file. UsageError: it cannot be read, or has a mistake."""
    document = people_file(path)
    try:
        for key in document.keys() - {"people", "seed", "questions"}:
            raise UsageError(f"{key!r} is an unknown key; allowed: people, seed, questions")
        count = document.get("people", design.study.participants)
        seed = document.get("seed", 1)
        if not all(type(one) is int and 0 <= one < 2**31 for one in (count, seed)) or not count:
            raise UsageError("people and seed are whole numbers, people above 0")
        if count > design.study.participants:
            most = design.study.participants
            raise UsageError(f"people={count}, but the design ends after {most} participants")
        truths = document.get("questions", {})
        if not isinstance(truths, dict):
            raise UsageError('"questions" is not a JSON object')
        return People(design, truths, seed, count)
    except UsageError as error:
        raise UsageError(f"{path}: {error}; see docs/study.md") from None


def chosen_probability(
    question: Question, trial: Trial, person: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the probability of each choice, in the order of `trial.choices`, lapses included."""
    names = [name for name in trial.conditions if name in question.conditions]
    place = question.conditions.index(names[0])
    if question.paradigm == "preference":
        one, other = (person["worth"][question.conditions.index(name)] for name in names)
        first = 1.0 / (1.0 + np.exp(other - one))
        p = np.array([first if choice == FIRST else 1.0 - first for choice in trial.choices])
    elif question.paradigm == "identification":
        right = min(1.0, float(person["accuracy"][place]))
        p = np.full(len(trial.choices), (1.0 - right) / (len(trial.choices) - 1))
        p[trial.choices.index(trial.stimulus)] = right
    else:
        x = trial.offset_ms
        if question.paradigm != "synchrony":
            at = next(i for i in (0, 1) if counted(trial, question, (FIRST, SECOND)[i]))
            place, x = question.conditions.index(trial.conditions[at]), trial.gains_db[at]
        keys = [key for key in person if key != "lapse"]
        value, jnd = (float(person[key][place]) for key in keys)
        yes = float(probability(question, np.array(x), np.array(value), np.array(jnd)))
        is_yes = [counted(trial, question, choice) for choice in trial.choices]
        p = np.where(is_yes, yes, 1.0 - yes)
    return with_lapses(p, float(person["lapse"][0]))


def answer(
    question: Question, trial: Trial, person: Mapping[str, FloatArray], rng: np.random.Generator
) -> tuple[str | float, float]:
    """Return a random answer of a person to a trial, and after how many seconds it comes."""
    after_s = round(0.5 + float(rng.gamma(2.0, 0.6)), 3)
    if question.paradigm == "rating":
        place = question.conditions.index(trial.conditions[1])
        rated = person["rating"][place] + person["noise"][place] * rng.standard_normal()
        is_random = rng.random() < person["lapse"][0]
        return round(float(np.clip(100.0 * rng.random() if is_random else rated, 0, 100))), after_s
    p = chosen_probability(question, trial, person)
    return trial.choices[drawn(p, rng)], after_s


def _parameters(question: Question, truth: Any) -> dict[str, FloatArray]:
    """Return each parameter of a question, with one value for each condition."""
    defaults = PARAMETERS[question.paradigm]
    known = {**defaults, **{f"{key}_spread": 0.0 for key in defaults}, "lapse": 0.0}
    if not isinstance(truth, dict):
        raise UsageError(f"{question.name} is not a table of parameters")
    for key, given in truth.items():
        names = known if key not in known else question.conditions
        for name in [key] if key not in known else given if isinstance(given, dict) else []:
            if name not in names:
                told = _allowed(name, list(names))
                raise UsageError(f"{question.name}: {name!r} is unknown; {told}")
    found = {}
    for key, default in known.items():
        given = truth.get(key, default)
        of = given if isinstance(given, dict) else dict.fromkeys(question.conditions, given)
        values: list[Any] = [of.get(name, default) for name in question.conditions]
        low, high = (0.0, 1.0) if key in ("lapse", "accuracy") else (-1e4, 1e4)
        if not all(type(one) in (int, float) and low <= one <= high for one in values):
            raise UsageError(
                f"{question.name}.{key}={given} is refused; allowed: {low:g} to {high:g}"
            )
        found[key] = np.array(values, dtype=float)
    return found


def _allowed(name: str, known: list[str]) -> str:
    guess = nearest(str(name), known)
    return f"allowed: {', '.join(known)}" + (f"; did you mean {guess}?" if guess else "")

"""Simulated people, whose true parameters are known, and the power of a design with them."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.config.toml_text import json_object
from audioflinger_hook.study.design import BUILT_IN, Design, people_schema, why_not
from audioflinger_hook.study.measure import Measured, chance, measure, p_value
from audioflinger_hook.study.session import Script
from audioflinger_hook.trials.record import Rows, run
from device.errors import UsageError
from device.units import FloatArray

STUDIES, LEVEL = 100, 0.05


class People:
    """Draws people and their answers. The same seed, person and trial give the same answer.

    truths: the parameters of each question, by its name, as `people_schema` describes them; others
    have the defaults of `paradigms.toml`. NAME_spread is the standard deviation between people, by
    default 0, and lapse the share of random answers.
    """

    def __init__(self, design: Design, truths: Mapping[str, Any], seed: int) -> None:
        self.design, self.seed, self._truths = design, seed, truths

    def person(self, name: str, number: int) -> dict[str, FloatArray]:
        """Return a person's parameters in a question, one value for each condition."""
        question, given = self.design.questions[name], self._truths.get(name, {})
        index, names = list(self.design.questions).index(name), question.conditions
        rng = np.random.default_rng((self.seed, index, number))

        def values(key: str, default: float) -> FloatArray:
            found = given.get(key, default)
            by_name = found if isinstance(found, dict) else dict.fromkeys(names, found)
            return np.array([float(by_name.get(one, default)) for one in names])

        person = {"lapse": values("lapse", 0.0)}
        for key, (default, low, high) in question.kind["parameters"].items():
            spread = values(f"{key}_spread", 0.0) * rng.standard_normal(len(names))
            person[key] = np.clip(values(key, default) + spread, low, high)
        return person

    def answer(self, number: int, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return a person's answer to a trial, as columns."""
        question = self.design.questions[row["question"]]
        person, at = self.person(question.name, number), question.conditions.index(row["tested"])
        rng = np.random.default_rng((self.seed, number, row["trial"], 7))
        after_s, is_lapse = 0.5 + rng.gamma(2.0, 0.6), rng.random() < person["lapse"][at]
        answer, choices = row["counted"], row["choices"]
        if question.paradigm == "rating":
            rated = person["rating"][at] + person["noise"][at] * rng.standard_normal()
            answer = round(float(np.clip(100.0 * rng.random() if is_lapse else rated, 0, 100)))
        elif is_lapse:
            answer = choices[rng.integers(len(choices))]
        elif rng.random() >= chance(question, row, person):
            answer = [one for one in choices if one != answer][rng.integers(len(choices) - 1)]
        return {"answer": answer, "answered_after_s": round(after_s, 3), "again": 0, "pauses": 0}


def load_people(path: Path, design: Design) -> tuple[People, int]:
    """Return the people of a JSON file, and their number. UsageError: it has a mistake."""
    schema = json.loads((BUILT_IN / "people.schema.json").read_text())
    schema["properties"]["people"]["maximum"] = most = design.study.participants
    for name, question in design.questions.items():
        own = people_schema(question.kind, question.conditions)
        schema["properties"]["questions"]["properties"][name] = own
    document = json_object(path)
    if problem := why_not(schema, document):
        raise UsageError(f"{path}: {problem}; see docs/study.md")
    people = People(design, document.get("questions", {}), document.get("seed", 1))
    return people, document.get("people", most)


def simulated_study(people: People, name: str, count: int) -> Measured:
    """Return what a study of one question with simulated people measures. No file is made."""
    question, answered = people.design.questions[name], []
    alone = replace(people.design, questions={name: question})
    for number in range(count):
        rows = run(Rows(), Script(alone, number), partial(people.answer, number))
        answered.append([row for row in rows if not row["practice"]])
    return measure(question, answered)


def power(design: Design, name: str, progress: Callable[[int, int], None]) -> float | None:
    """Return the share of simulated studies that find a question's `effect`; None without one.

    A study finds the effect if p is below 0.05. None also if there is no test. progress: called
    with the studies done and in total.
    """
    effect, found = design.questions[name].effect, []
    for seed in range(STUDIES if effect else 0):
        people = People(design, {name: effect}, design.study.seed + seed)
        p = p_value(simulated_study(people, name, design.study.participants))
        if p is None:
            return None
        found.append(p < LEVEL)
        progress(seed + 1, STUDIES)
    return float(np.mean(found)) if found else None

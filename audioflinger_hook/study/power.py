"""Whole simulated studies, and the power of a design for a stated effect."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from audioflinger_hook.study.design import Design, Question
from audioflinger_hook.study.estimates import Answered, Measured, measure, p_values
from audioflinger_hook.study.people import People
from audioflinger_hook.study.session import Simulated, run, trial_of
from audioflinger_hook.trials.record import Rows

STUDIES, LEVEL = 100, 0.05


def simulated_study(design: Design, name: str, people: People) -> Measured:
    """Return what a study of one question with simulated people measures. No file is made."""
    question = design.questions[name]
    alone = replace(design, questions={name: question})
    answered: list[Answered] = []
    for number in range(people.count):
        rows = run(alone, number, Rows(), Simulated(people, number))
        answered.append([(trial_of(row), row["answer"]) for row in rows if not row["practice"]])
    return measure(question, answered)


def power(design: Design, question: Question, progress: Callable[[int, int], None]) -> float | None:
    """Return the share of simulated studies that find the question's `effect`; None without one.

    A study finds the effect if the test of all comparisons together gives p below 0.05. None also
    if there is no such test. progress: called with the studies done and in total.
    """
    if question.effect is None:
        return None
    alone = replace(design, questions={question.name: question})
    found = []
    for seed in range(STUDIES):
        count = design.study.participants
        people = People(alone, {question.name: question.effect}, design.study.seed + seed, count)
        p, _ = p_values(simulated_study(alone, question.name, people))
        if p is None:
            return None
        found.append(p < LEVEL)
        progress(seed + 1, STUDIES)
    return float(np.mean(found))

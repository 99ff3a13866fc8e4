"""The trials of a participant: their order and sides are balanced exactly, then shuffled."""

from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.study.design import Design, Question

FIRST, SECOND = "1", "2"
JUDGEMENTS = {"simultaneity": ("yes", "no"), "order": ("sound", "vibration")}


@dataclass(frozen=True)
class Trial:
    """One trial. Two intervals have two conditions, one interval has one.

    number: place in the participant's session, from 1. block: from 1. offset_ms: delay of the
    vibration. gains_db: of each interval, added to the condition's. choices: in the order of their
    buttons.
    """

    question: str
    stimulus: str
    conditions: tuple[str, ...]
    choices: tuple[str, ...] = ()
    offset_ms: float = 0.0
    gains_db: tuple[float, ...] = (0.0, 0.0)
    number: int = 0
    block: int = 0
    is_practice: bool = False


def session(design: Design, participant: int) -> list[Trial]:
    """Return all trials of a participant in their order, practice included.

    participant: number of the participant, from 0. Equal numbers give equal trials. The questions
    rotate from participant to participant. For each pair of conditions and each sound, each
    condition comes first in half of the trials, and each answer is on the left in half of them.
    """
    names = list(design.questions)
    turned = names[participant % len(names) :] + names[: participant % len(names)]
    trials: list[Trial] = []
    for name in turned:
        question = design.questions[name]
        rng = np.random.default_rng((design.study.seed, participant, names.index(name)))
        kinds = balanced(question, participant)
        kinds = [kinds[i] for i in rng.permutation(len(kinds))]
        practice = [kinds[i % len(kinds)] for i in range(design.study.practice)]
        trials += [replace(trial, is_practice=True) for trial in practice] + kinds
    done, numbered = 0, []
    for number, trial in enumerate(trials, 1):
        numbered.append(replace(trial, number=number, block=1 + done // design.study.block))
        done += not trial.is_practice
    return numbered


def balanced(question: Question, participant: int) -> list[Trial]:
    """Return a participant's trials of one question, not shuffled."""
    trials = []
    delays = question.offsets_ms if question.paradigm == "synchrony" else (0.0,)
    for s, stimulus in enumerate(question.stimuli):
        for pair in question.pairs:
            for offset_ms in delays:
                for repeat in range(question.repeats):
                    trial = Trial(question.name, stimulus, pair, offset_ms=offset_ms)
                    trials.append(_sided(trial, question, s, repeat, participant))
    return trials


def _sided(trial: Trial, question: Question, s: int, repeat: int, participant: int) -> Trial:
    if question.paradigm == "rating":
        return trial
    if question.paradigm == "identification":
        turn = participant % len(question.stimuli)
        names = tuple(question.stimuli)
        return replace(trial, conditions=trial.conditions[:1], choices=names[turn:] + names[:turn])
    # Over two repeats, order and side each take both values; over four, all combinations come.
    order, side = repeat % 2, (repeat + repeat // 2 + participant + s) % 2
    choices = JUDGEMENTS[question.judgement] if trial.conditions[1] == "" else (FIRST, SECOND)
    conditions = trial.conditions[:1] if trial.conditions[1] == "" else trial.conditions
    if order:
        conditions = conditions[::-1]
    return replace(trial, conditions=conditions, choices=choices[::-1] if side else choices)


def tested(trial: Trial, question: Question) -> int:
    """Return which interval of an adaptive trial has the tested condition, 0 or 1."""
    return int(trial.conditions[0] == question.pairs[0][1])


def counted(trial: Trial, question: Question, answer: str) -> bool:
    """Return whether the answer is the one that `curves` counts. answer: one of the choices."""
    if question.paradigm == "synchrony":
        return answer == JUDGEMENTS[question.judgement][0]
    return answer == (FIRST, SECOND)[tested(trial, question)]


def at_level(trial: Trial, question: Question, level_db: float) -> Trial:
    """Return an adaptive trial in which the tested condition has this level."""
    place = tested(trial, question)
    return replace(trial, gains_db=tuple(level_db if i == place else 0.0 for i in (0, 1)))

"""Studies in a folder, and simulated ones in memory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray
from scipy.stats import norm

from audioflinger_hook.study.design import Design, Question, load
from audioflinger_hook.study.measure import bradley_terry, chance, information
from audioflinger_hook.study.people import People
from audioflinger_hook.study.session import balanced

RATE = 48_000
QUESTIONS = {
    "preference": 'conditions = ["a", "b", "c"]\nrepeats = 2',
    "rating": 'conditions = ["a", "b", "c"]\nrepeats = 2\nreference = "a"\nanchor = "c"',
    "synchrony": 'conditions = ["a"]\nrepeats = 6',
    "threshold": 'conditions = ["a", "b"]\nrepeats = 30',
    "equal": 'conditions = ["a", "b"]\nreference = "a"\nrepeats = 30\nlowest_db = -12\n'
    "highest_db = 12",
    "identification": 'conditions = ["a", "b"]\nrepeats = 6',
}
TRUTHS = {
    "preference": {"worth": {"a": 0.7, "b": -0.1, "c": -0.6}, "worth_spread": 0.4},
    "rating": {"rating": {"a": 95, "b": 60, "c": 30}, "rating_spread": 8},
    "synchrony": {"pss_ms": 20, "pss_ms_spread": 20, "jnd_ms": 80, "jnd_ms_spread": 10},
    "threshold": {"threshold_db": {"a": -20, "b": -15}, "threshold_db_spread": 3},
    "equal": {"equal_db": {"b": 3}, "equal_db_spread": 2},
    "identification": {"accuracy": {"a": 0.85, "b": 0.7}, "accuracy_spread": 0.08},
}
"""True parameters of simulated people, by paradigm."""


def design_text(*paradigms: str, participants: int = 20, more: str = "") -> str:
    """Return a design with a question of each paradigm, named after it."""
    text = f'title = "t"\nparticipants = {participants}\nlevel_db = -40\n{more}\n'
    for name, method in (("a", "band-pass"), ("b", "envelope"), ("c", "octave-fold")):
        text += f'[[condition]]\nname = "{name}"\nmethod = "{method}"\n'
    for name in paradigms:
        text += (
            f'[[question]]\nname = "{name}"\nparadigm = "{name}"\nstimuli = ["x.wav", "y.wav"]\n'
        )
        text += QUESTIONS[name] + "\n"
    return text


def make_study(folder: Path, *paradigms: str, participants: int = 20, more: str = "") -> Design:
    """Write a study with two short sounds to a folder, and return its design."""
    folder.mkdir(exist_ok=True)
    rng, time_s = np.random.default_rng(1), np.arange(RATE // 5) / RATE
    for name, hz in (("x", 600.0), ("y", 1500.0)):
        sound = 0.2 * np.sin(2 * np.pi * hz * time_s) + 0.1 * rng.standard_normal(time_s.size)
        soundfile.write(folder / f"{name}.wav", sound, RATE, subtype="FLOAT")
    text = design_text(*paradigms, participants=participants, more=more)
    (folder / "design.toml").write_text(text)
    return load(folder)


def truth(question: Question, people: People, count: int = 4_000) -> NDArray[np.float64]:
    """Return the true values of what a question measures, for people drawn without end.

    For preference and identification, it is computed from the mean probabilities of all answers.
    """
    drawn = [people.person(question.name, number) for number in range(count)]
    names, sounds = question.conditions, question.stimuli
    if question.paradigm in ("preference", "identification"):
        wins = np.zeros((1, len(names), len(names)))
        confusion = np.zeros((1, len(names), len(sounds), len(sounds)))
        rows = {(r["stimulus"], r["tested"], r["against"]): r for r in balanced(question, 0)}
        for row in rows.values():
            lapse, size = drawn[0]["lapse"][0], len(row["choices"])
            p = np.mean([chance(question, row, one) for one in drawn]) * (1 - lapse) + lapse / size
            at = names.index(row["tested"])
            if question.paradigm == "identification":
                sound = sounds.index(row["stimulus"])
                confusion[0, at, sound] += (1 - p) / (size - 1)
                confusion[0, at, sound, sound] += p - (1 - p) / (size - 1)
            else:
                other = names.index(row["against"])
                wins[0, at, other] += p
                wins[0, other, at] += 1 - p
        is_wins = question.paradigm == "preference"
        return np.asarray((bradley_terry(wins) if is_wins else information(confusion))[0])
    if question.paradigm == "rating":
        z = norm.ppf((np.arange(200) + 0.5) / 200)[:, None]  # ratings end at 0 and 100
        rated = [
            (1.0 - one["lapse"]) * np.clip(one["rating"] + z * one["noise"], 0, 100)
            + one["lapse"] * 50.0
            for one in drawn
        ]
        mean = np.mean(rated, axis=(0, 1))
        return np.append(mean, mean[1] - mean[2])  # b over the anchor c
    places = [names.index(pair[0]) for pair in question.pairs]
    place, jnd = (
        np.mean([one[key] for one in drawn], axis=0)[places] for key in question.kind["parameters"]
    )
    is_window = question.paradigm == "synchrony" and question.judgement == "simultaneity"
    return np.concatenate([place, jnd, *([place - jnd, place + jnd] if is_window else ())])


def changed(design: Design, name: str, **keys: object) -> Design:
    """Return a design of one question only, with other values of some keys."""
    return replace(design, questions={name: Question(**vars(design.questions[name]) | keys)})

"""Studies in a folder, and simulated ones in memory."""

from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.study.design import Design
from audioflinger_hook.study.design_check import load

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
    for name in "xy":
        text += f'[[stimulus]]\nname = "{name}"\nfile = "{name}.wav"\n'
    for name, method in (("a", "band-pass"), ("b", "envelope"), ("c", "octave-fold")):
        text += f'[[condition]]\nname = "{name}"\nmethod = "{method}"\n'
    for name in paradigms:
        text += f'[[question]]\nname = "{name}"\nparadigm = "{name}"\nstimuli = ["x", "y"]\n'
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

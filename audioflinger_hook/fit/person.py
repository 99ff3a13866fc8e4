"""A person who compares two vibrations, by keys of the terminal or on the page."""

import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.fit.curve import REFERENCE_HZ
from audioflinger_hook.fit.session import FIRST, SECOND, TRIALS_MOST, UNKNOWN, Trial
from audioflinger_hook.service.status import ExposureFigures
from audioflinger_hook.trials import page
from audioflinger_hook.trials.page import Answer, Answers, Choice, Kind, Question
from audioflinger_hook.trials.player import Player
from device.drive.exposure import ACTION_A8_M_S2, ACTION_VDV
from device.errors import UsageError
from device.units import Float32Array, db_to_amplitude

RATE_HZ = 48_000
TONE_S, EDGE_S, PAUSE_S = 0.6, 0.05, 0.4
START_DBFS, STEP_DB, MOST_DBFS = -42.0, 3.0, -12.0  # level of the reference, which a person raises
PEAK_DBFS = -1.0  # of a test
LIMITED_DB = 0.5  # by more protection, the level is lowered, and the trial played again
EXPOSURE_SHARE = 0.5  # of an action value of 2002/44/EC, which a fit may use

CHOICES = (replace(page.FIRST, value=FIRST), replace(page.SECOND, value=SECOND))
LEVELS = (
    Choice("louder", "Stronger", "+"),
    Choice("softer", "Weaker", "-"),
    Choice("good", "Clear and comfortable", "c"),
)
PLAYING = Question(Kind.PLAYING, "Feel", ("Which of the two vibrations is stronger?",))
ASKED = Question(
    Kind.CHOICE,
    "Which vibration was stronger?",
    choices=CHOICES,
    also=(page.AGAIN, replace(page.UNKNOWN, value=UNKNOWN)),
    total=TRIALS_MOST,
)


def tones(*parts: tuple[float, float]) -> Float32Array:
    """Return vibrations one after the other, mono at 48 kHz. parts: Hz and dBFS of each."""
    time_s = np.arange(round(TONE_S * RATE_HZ)) / RATE_HZ
    rise = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / EDGE_S)
    edges = 0.5 - 0.5 * np.cos(np.pi * rise)
    pause = np.zeros(round(PAUSE_S * RATE_HZ))
    edge = np.zeros(round(EDGE_S * RATE_HZ))  # the player fades the first and last 50 ms
    waves = [db_to_amplitude(db) * edges * np.sin(math.tau * hz * time_s) for hz, db in parts]
    between = [piece for wave in waves for piece in (wave, pause)][:-1]
    return np.concatenate((edge, *between, edge)).astype(np.float32)


class Person:
    """Plays trials to a person and asks; implements `Sitter`. Use it in a `with` block.

    reference_dbfs: level of the reference. If None, the person raises it from a low level.
    player, answers: play and ask. exposure: returns the daemon's reading, None without a rig.
    """

    def __init__(
        self,
        player: Player,
        answers: Answers,
        exposure: Callable[[], ExposureFigures | None],
        reference_dbfs: float | None = None,
    ) -> None:
        self._player, self._answers, self._exposure = player, answers, exposure
        self._folder = tempfile.TemporaryDirectory()
        self.reference_dbfs = START_DBFS if reference_dbfs is None else reference_dbfs

    def __enter__(self) -> "Person":
        return self

    def __exit__(self, *_error: object) -> None:
        self._player.stop()
        self._folder.cleanup()

    @property
    def headroom_db(self) -> float:
        """Highest level of a test, in dB relative to the reference."""
        return PEAK_DBFS - self.reference_dbfs

    def choose_level(self) -> None:
        """Let the person raise the reference until it is clear and comfortable."""
        told = ("Make the vibration clear and comfortable. It starts weak.",)
        while True:
            self._play(tones((REFERENCE_HZ, self.reference_dbfs)), Question(Kind.PLAYING, "Feel"))
            asked = Question(Kind.CHOICE, "How strong is it?", told, LEVELS, (page.AGAIN,))
            said = self._answers.ask(asked).value
            if said == "good":
                return
            step_db = {"louder": STEP_DB, "softer": -STEP_DB}.get(str(said), 0.0)
            self.reference_dbfs = min(max(START_DBFS, self.reference_dbfs + step_db), MOST_DBFS)

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial, again if the person asks for it, and return the answer.

        UsageError: half of an exposure action value is reached. Errors of player and answers pass.
        """
        said, repeats = page.AGAIN.value, -1
        while said == page.AGAIN.value:
            test = trial.hz, self.reference_dbfs + trial.level_db
            parts = test, (REFERENCE_HZ, self.reference_dbfs)
            if self._play(tones(*(parts if trial.test_first else parts[::-1])), PLAYING):
                continue
            repeats += 1
            said = str(self._answers.ask(replace(ASKED, done=trial.number)).value)
        return {"answer": said, "again": repeats, "reference_dbfs": self.reference_dbfs}

    def _play(self, frames: Float32Array, shown: Question) -> bool:
        """Play; return whether protection limited it, after which the level is lower."""
        read = self._exposure()
        if read is not None and (
            read.a8_m_s2 >= EXPOSURE_SHARE * ACTION_A8_M_S2
            or read.vdv >= EXPOSURE_SHARE * ACTION_VDV
        ):
            raise UsageError(
                f"today's exposure is A(8) {read.a8_m_s2:.2g} m/s²; a fit may use half of the "
                "action value; go on tomorrow, all answers are kept"
            )
        path = Path(self._folder.name) / "trial.npy"
        np.save(path, frames)
        played = page.play_whole(self._player, self._answers, (None, path), shown)
        limited = played.protection_db > LIMITED_DB and self.reference_dbfs > START_DBFS
        if limited:
            self.reference_dbfs = max(START_DBFS, self.reference_dbfs - STEP_DB)
        return limited


class TerminalAnswers:
    """Asks on the terminal; implements `Answers`. keys: `pressed_keys` of the terminal."""

    def __init__(self, keys: Callable[[float], str]) -> None:
        self._keys = keys

    def show(self, question: Question) -> None:
        """Print the title."""
        print(question.title, file=sys.stderr, flush=True)

    def ask(self, question: Question) -> Answer:
        """Print a question with its keys; return the answer."""
        offered = {one.key: one for one in (*question.choices, *question.also)}
        keys = ", ".join(f"{key} {one.label.lower()}" for key, one in offered.items())
        while self._keys(0.0):  # pressed before the question
            pass
        print(*question.text, f"{question.title} ({keys})", sep="\n", file=sys.stderr, flush=True)
        while (pressed := self._keys(60.0).lower()) not in offered:
            pass
        return Answer(offered[pressed].value, 0.0)

    def wait(self) -> None:
        """Return at once: a terminal has no pause."""

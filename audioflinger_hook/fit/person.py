"""The vibrations that a person compares, and their levels."""

import math
from typing import Any

import numpy as np

from audioflinger_hook.fit.curve import REFERENCE_HZ
from audioflinger_hook.fit.session import FIRST, SECOND, TRIALS_MOST, UNKNOWN, Trial
from audioflinger_hook.trials.page import AGAIN, screen
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import Played
from device.units import Float32Array, db_to_amplitude

RATE_HZ = 48_000
TONE_S, EDGE_S, PAUSE_S = 0.6, 0.05, 0.4
START_DBFS, STEP_DB, MOST_DBFS = -42.0, 3.0, -12.0  # level of the reference, which a person raises
PEAK_DBFS = -1.0  # of a test
LIMITED_DB = 0.5  # by more protection, the level is lowered, and the trial played again

GOOD = "Clear and comfortable"
CHOICES = (FIRST, "First", "1"), (SECOND, "Second", "2")
LEVELS = (
    ("louder", "Stronger", "+"),
    ("softer", "Weaker", "-"),
    ("good", "Clear and comfortable", "c"),
)
PLAYING = screen("playing", "Feel", "Which of the two vibrations is stronger?")


def tones(*parts: tuple[float, float]) -> Float32Array:
    """Return vibrations one after the other, (frames, 1) at 48 kHz. parts: Hz and dBFS of each."""
    time_s = np.arange(round(TONE_S * RATE_HZ)) / RATE_HZ
    rise = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / EDGE_S)
    edges = 0.5 - 0.5 * np.cos(np.pi * rise)
    pause = np.zeros(round(PAUSE_S * RATE_HZ))
    edge = np.zeros(round(EDGE_S * RATE_HZ))  # the player fades the first and last 50 ms
    waves = [db_to_amplitude(db) * edges * np.sin(math.tau * hz * time_s) for hz, db in parts]
    between = [piece for wave in waves for piece in (wave, pause)][:-1]
    return np.concatenate((edge, *between, edge)).astype(np.float32)[:, None]


class FittedPerson:
    """A person who compares vibrations; implements `Sitter`.

    person: feels and answers. reference_dbfs: level of the reference; None before `choose_level`.
    """

    def __init__(self, person: Person, reference_dbfs: float | None = None) -> None:
        self._person = person
        self.reference_dbfs = START_DBFS if reference_dbfs is None else reference_dbfs

    @property
    def headroom_db(self) -> float:
        """Highest level of a test, in dB relative to the reference."""
        return PEAK_DBFS - self.reference_dbfs

    def choose_level(self) -> None:
        """Let the person raise the reference from a low level until it is comfortable."""
        told = "Make the vibration clear and comfortable. It starts weak."
        asked = screen("choice", "How strong is it?", told, choices=LEVELS, also=[AGAIN])
        said = ""
        while said != "good":
            level_db = self.reference_dbfs + {"louder": STEP_DB, "softer": -STEP_DB}.get(said, 0.0)
            self.reference_dbfs = min(max(START_DBFS, level_db), MOST_DBFS)
            shown = tones((REFERENCE_HZ, self.reference_dbfs))
            self._is_allowed(self._person.play(None, shown, screen("playing", "Feel")))
            said = str(self._person.answers.ask(asked).value)

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial, again if the person asks for it; return the columns of the answer."""

        def intervals() -> list[Any]:
            test = trial.hz, self.reference_dbfs + trial.level_db
            parts = test, (REFERENCE_HZ, self.reference_dbfs)
            frames = tones(*(parts if trial.test_first else parts[::-1]))
            return [(None, frames, PLAYING)]

        about: dict[str, Any] = {"done": trial.number, "total": TRIALS_MOST}
        also = AGAIN, (UNKNOWN, "Don't know", "d")
        title = "Which vibration was stronger?"
        asked = screen("choice", title, choices=CHOICES, also=also, **about)
        _, columns = self._person.answer(intervals, asked, self._is_allowed)
        return {**columns, "reference_dbfs": self.reference_dbfs}

    def _is_allowed(self, played: Played) -> bool:
        """Return whether protection left it as it was; else lower the level."""
        limited = played.protection_db > LIMITED_DB and self.reference_dbfs > START_DBFS
        if limited:
            self.reference_dbfs = max(START_DBFS, self.reference_dbfs - STEP_DB)
        return not limited

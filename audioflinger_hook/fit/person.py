"""A person who compares vibrations, and the levels of these."""

import math
from typing import Any

import numpy as np

from audioflinger_hook.fit.curve import REFERENCE_HZ
from audioflinger_hook.fit.session import FIRST, SECOND, TRIALS_MOST, UNKNOWN, Trial
from audioflinger_hook.trials.page import AGAIN, screen
from audioflinger_hook.trials.person import Interval, Person
from audioflinger_hook.trials.player import Played
from device.units import Float32Array, db_to_amplitude

RATE_HZ = 48_000
TONE_S, EDGE_S, PAUSE_S = 0.6, 0.05, 0.4
START_DBFS, STEP_DB, MOST_DBFS = -42.0, 3.0, -12.0  # level of the reference, which a person raises
PEAK_DBFS = -1.0  # of a test
LIMITED_DB = 0.5  # by more protection, the level is lowered, and the trial played again

STEPS = {"louder": STEP_DB, "softer": -STEP_DB}
LEVEL = screen(
    *("choice", "How strong is it?"),
    "Make the vibration clear and comfortable. It starts weak.",
    choices=[
        ("louder", "Stronger", "+"),
        ("softer", "Weaker", "-"),
        ("good", "Clear and comfortable", "c"),
    ],
    also=[AGAIN],
)
ASKED = screen(
    *("choice", "Which vibration was stronger?"),
    choices=[(FIRST, "First", "1"), (SECOND, "Second", "2")],
    also=[AGAIN, (UNKNOWN, "Don't know", "d")],
    total=TRIALS_MOST,
)


def tones(*parts: tuple[float, float]) -> Float32Array:
    """Return vibrations one after the other, (frames, 1) at 48 kHz. parts: Hz and dBFS of each."""
    time_s = np.arange(round(TONE_S * RATE_HZ)) / RATE_HZ
    rise = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / EDGE_S)
    edges = 0.5 - 0.5 * np.cos(np.pi * rise)
    pause, edge = (np.zeros(round(s * RATE_HZ)) for s in (PAUSE_S, EDGE_S))
    waves = [db_to_amplitude(db) * edges * np.sin(math.tau * hz * time_s) for hz, db in parts]
    between = [piece for wave in waves for piece in (wave, pause)][:-1]
    # the player fades the first and last 50 ms
    return np.concatenate((edge, *between, edge)).astype(np.float32)[:, None]


class FittedPerson:
    """A person who compares vibrations; implements `Sitter`.

    reference_dbfs: level of the reference; None lets the person raise it from a low level.
    """

    def __init__(self, person: Person, reference_dbfs: float | None = None) -> None:
        self._person, said = person, ""
        self.reference_dbfs = START_DBFS if reference_dbfs is None else reference_dbfs
        while reference_dbfs is None and said != "good":
            level_db = self.reference_dbfs + STEPS.get(said, 0.0)
            self.reference_dbfs = min(max(START_DBFS, level_db), MOST_DBFS)
            shown = screen("playing", "Feel")
            self._is_allowed(person.play(None, tones((REFERENCE_HZ, self.reference_dbfs)), shown))
            said = str(person.answers.ask(LEVEL).value)

    @property
    def headroom_db(self) -> float:
        """Highest level of a test, in dB relative to the reference."""
        return PEAK_DBFS - self.reference_dbfs

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial, again if the person asks for it; return the columns of the answer."""

        def intervals() -> list[Interval]:
            test = trial["hz"], self.reference_dbfs + trial["level_db"]
            parts = test, (REFERENCE_HZ, self.reference_dbfs)
            shown = screen("playing", "Feel", "Which of the two vibrations is stronger?")
            return [(None, tones(*(parts if trial["test_first"] else parts[::-1])), shown)]

        asked = {**ASKED, "done": trial["trial"]}
        _, columns = self._person.answer(intervals, asked, self._is_allowed)
        return {**columns, "reference_dbfs": self.reference_dbfs}

    def _is_allowed(self, played: Played) -> bool:
        """Return whether protection left it as it was; else lower the level."""
        limited = played.protection_db > LIMITED_DB and self.reference_dbfs > START_DBFS
        if limited:
            self.reference_dbfs = max(START_DBFS, self.reference_dbfs - STEP_DB)
        return not limited

"""The trials of a fit, and who answers them: a person or a simulated one."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.special import ndtr

from audioflinger_hook.config.kinds import Curve, curve_text
from audioflinger_hook.fit.curve import REFERENCE_HZ, CurvePosterior
from audioflinger_hook.transform.design.strength import interpolated_db
from audioflinger_hook.trials.page import AGAIN, UNKNOWN, screen
from audioflinger_hook.trials.person import Interval, Person
from audioflinger_hook.trials.player import Played
from audioflinger_hook.trials.simulated import drawn, with_lapses
from device.units import Float32Array, db_to_amplitude
from device.values import Described, Number

TRIALS_MOST, TRIALS_A_MINUTE = 60, 20
ENOUGH_DB = 1.0  # the fit ends when no frequency is less certain than this
BLOCK = 7  # one trial of each block is a catch trial
CATCH_DB = 12.0  # level difference of a catch trial, whose two frequencies are the same
CATCHES_LAST = 8  # of the last trials, as many are catch trials as needed to reach SURE
SURE = 3.0  # evidence of the catch trials, relative to guessing, natural logarithm
GUESSED = 1.0  # with less evidence, the answers count as guessed

RATE_HZ = 48_000
TONE_S, EDGE_S, PAUSE_S = 0.6, 0.05, 0.4
START_DBFS, STEP_DB, MOST_DBFS = -42.0, 3.0, -12.0  # level of the reference, which a person raises
PEAK_DBFS = -1.0  # of a test
LIMITED_DB = 0.5  # by more protection, the level is lowered, and the trial played again

FIRST, SECOND = ("first", "First", "1"), ("second", "Second", "2")
STEPS_DB = {"louder": STEP_DB, "softer": -STEP_DB}
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

Trial = Mapping[str, Any]
"""The columns of a trial.

trial: number from 0. hz, level_db: frequency of the test, and its level relative to the reference.
test_first: whether the test is first."""


@dataclass(frozen=True)
class SimulatedSitter(Described):
    """A simulated person. An answer depends on `seed` and on its own trial only."""

    curve_db: Annotated[Mapping[Any, float], Curve("sensitivity in dB by Hz")]
    jnd_db: Annotated[float, Number("deviation of the decision noise", 1e-3, 1e6, "dB")] = 1.5
    lapse: Annotated[float, Number("share of answers that are guessed", 0.0, 1.0)] = 0.0
    seed: Annotated[int, Number("seed of noise and guesses", 0, 2**53, whole=True)] = 0
    headroom_db = math.inf

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Return the answer to a trial."""
        hz = np.array([trial["hz"], REFERENCE_HZ])
        test, reference = interpolated_db(curve_text(self.curve_db), hz)
        stronger = ndtr((test - reference + trial["level_db"]) / self.jnd_db)
        chances = with_lapses(np.array([stronger, 1.0 - stronger]), self.lapse)
        # not from the stream of [seed, number], which draws the trial itself
        is_weaker = drawn(chances, np.random.default_rng([self.seed, trial["trial"], 7]))
        return {"answer": (SECOND if is_weaker == trial["test_first"] else FIRST)[0]}


class FittedPerson:
    """A person who compares vibrations.

    headroom_db: highest level of a test, in dB relative to the reference. reference_dbfs: level of
    the reference; None lets the person raise it from a low level.
    """

    def __init__(self, person: Person, reference_dbfs: float | None = None) -> None:
        self._person, said = person, ""
        self.reference_dbfs = START_DBFS if reference_dbfs is None else reference_dbfs
        while reference_dbfs is None and said != "good":
            level_db = self.reference_dbfs + STEPS_DB.get(said, 0.0)
            self.reference_dbfs = min(max(START_DBFS, level_db), MOST_DBFS)
            shown = screen("playing", "Feel")
            self._is_allowed(person.play(None, tones((REFERENCE_HZ, self.reference_dbfs)), shown))
            said = str(person.answers.ask(LEVEL).value)

    @property
    def headroom_db(self) -> float:  # noqa: D102
        return PEAK_DBFS - self.reference_dbfs

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial, again if the person asks for it; return the columns of the answer."""

        def intervals() -> list[Interval]:
            test = trial["hz"], self.reference_dbfs + trial["level_db"]
            parts = [test, (REFERENCE_HZ, self.reference_dbfs)][:: 1 if trial["test_first"] else -1]
            return [
                (None, tones(*parts), screen("playing", "Feel", "Which of the two is stronger?"))
            ]

        asked = screen(
            *("choice", "Which vibration was stronger?"),
            choices=[FIRST, SECOND],
            also=[AGAIN, UNKNOWN],
            done=trial["trial"],
            total=TRIALS_MOST,
        )
        _, columns = self._person.answer(intervals, asked, self._is_allowed)
        return {**columns, "reference_dbfs": self.reference_dbfs}

    def _is_allowed(self, played: Played) -> bool:
        """Return whether protection left it as it was; else lower the level."""
        limited = played.protection_db > LIMITED_DB and self.reference_dbfs > START_DBFS
        self.reference_dbfs = max(START_DBFS, self.reference_dbfs - STEP_DB * limited)
        return not limited


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


class FitSession:
    """One fit; implements `Script`. `posterior` is what its answers say.

    sitter: who answers. seed: of orders and catch trials. most: largest number of trials.
    """

    def __init__(
        self, sitter: SimulatedSitter | FittedPerson, seed: int, most: int = TRIALS_MOST
    ) -> None:
        self.posterior, self._catches, self._wrong = CurvePosterior(), 0, 0
        self._sitter, self._seed, self._most, self._taken = sitter, seed, most, 0

    @property
    def refusal(self) -> str:
        """Why the answers cannot be used, or ""."""
        if self.posterior.catch_evidence < GUESSED:
            clear = f"of {self._catches} comparisons {CATCH_DB:g} dB apart"
            return f"{clear}, {self._wrong} were wrong or not decided"
        guessed = "the answers contradict each other, as guesses would"
        return guessed if self.posterior.evidence < GUESSED else ""

    def next_trial(self) -> tuple[Trial, Trial] | None:
        """Return the trial to play next, twice; None if the fit is over."""
        number, is_sure = self._taken, self.posterior.catch_evidence >= SURE
        is_known = self.posterior.uncertainty_db.max() < ENOUGH_DB
        if number >= self._most or (is_known and is_sure):
            return None
        random = np.random.default_rng([self._seed, number])
        test_first, louder = (bool(flip) for flip in random.integers(0, 2, 2))
        block, place = divmod(number, BLOCK)
        is_catch = place == np.random.default_rng([self._seed, block, BLOCK]).integers(1, BLOCK)
        headroom_db = self._sitter.headroom_db
        if is_catch or (number >= self._most - CATCHES_LAST and not is_sure):
            hz, level_db = REFERENCE_HZ, CATCH_DB
            level_db *= 1.0 if louder and headroom_db >= CATCH_DB else -1.0
        else:
            hz, level_db = self.posterior.next_trial(headroom_db)
        trial = {"trial": number, "hz": hz, "level_db": level_db, "test_first": test_first}
        return trial, trial

    def take(self, row: Mapping[str, Any]) -> None:
        """Learn from a recorded answer."""
        is_first = float((row["answer"] == FIRST[0]) == row["test_first"])
        stronger = 0.5 if row["answer"] == UNKNOWN[0] else is_first
        self.posterior.add(row["hz"], row["level_db"], stronger)
        self._taken += 1
        if row["hz"] == REFERENCE_HZ:
            self._catches += 1
            self._wrong += stronger != float(row["level_db"] > 0.0)

"""The trials of a fit, and who answers them: a person or a simulated one.

A trial has the columns trial (from 0), hz and level_db (of the test; relative to the reference),
and test_first. A sitter has `answer`, which adds the column answer, and `headroom_db`, the highest
level of a test in dB relative to the reference.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.signal.windows import tukey
from scipy.special import ndtr

from audioflinger_hook.config.kinds import Curve, curve_text
from audioflinger_hook.fit.curve import REFERENCE_HZ, CurvePosterior
from audioflinger_hook.transform.design.strength import interpolated_db
from audioflinger_hook.trials.page import AGAIN, UNKNOWN, screen
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import Played
from audioflinger_hook.trials.simulated import drawn, with_lapses
from device.units import Float32Array, db_to_amplitude
from device.values import Described, Number

TRIALS_MOST = 60
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

STEPS_DB = {"louder": STEP_DB, "softer": -STEP_DB}
LEVELS = [("louder", "Stronger", "+"), ("softer", "Weaker", "-"), ("good", "Clear", "c")]
LEVEL = screen("choice", "Is it clear and comfortable?", choices=LEVELS, also=[AGAIN])
ORDER = [("first", "First", "1"), ("second", "Second", "2")]
STRONGER = screen("choice", "Which was stronger?", choices=ORDER, also=[AGAIN, UNKNOWN])
FEEL = screen("playing", "Feel")

Trial = Mapping[str, Any]


@dataclass(frozen=True)
class SimulatedSitter(Described):
    """A simulated person. An answer depends on `seed` and on its own trial only."""

    curve_db: Annotated[Mapping[Any, float], Curve("sensitivity in dB by Hz")]
    jnd_db: Annotated[float, Number("deviation of the decision noise", 1e-3, 1e6, "dB")] = 1.5
    lapse: Annotated[float, Number("share of answers that are guessed", 0.0, 1.0)] = 0.0
    seed: Annotated[int, Number("seed of noise and guesses", 0, 2**53, whole=True)] = 0
    headroom_db = math.inf

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Answer a trial."""
        hz = np.array([trial["hz"], REFERENCE_HZ])
        test_db, reference_db = interpolated_db(curve_text(self.curve_db), hz)
        stronger = ndtr((test_db - reference_db + trial["level_db"]) / self.jnd_db)
        chances = with_lapses(np.array([stronger, 1.0 - stronger]), self.lapse)
        # not from the stream of [seed, number], which draws the trial itself
        is_weaker = drawn(chances, np.random.default_rng([self.seed, trial["trial"], 7]))
        return {"answer": "second" if is_weaker == trial["test_first"] else "first"}


class FittedPerson:
    """A person, who raises the level of the reference if `reference_dbfs` is None."""

    def __init__(self, person: Person, reference_dbfs: float | None = None) -> None:
        self._person, said = person, ""
        self.reference_dbfs = START_DBFS if reference_dbfs is None else reference_dbfs
        while reference_dbfs is None and said != "good":
            level_db = self.reference_dbfs + STEPS_DB.get(said, 0.0)
            self.reference_dbfs = min(max(START_DBFS, level_db), MOST_DBFS)
            self._is_whole(person.play(None, tones((REFERENCE_HZ, self.reference_dbfs)), FEEL))
            said = str(person.answers.ask(LEVEL).value)

    @property
    def headroom_db(self) -> float:  # noqa: D102
        return PEAK_DBFS - self.reference_dbfs

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial until it is whole and the person answers; add the reference's level."""

        def vibration() -> Float32Array:
            test = trial["hz"], self.reference_dbfs + trial["level_db"]
            reference = REFERENCE_HZ, self.reference_dbfs
            return tones(*((test, reference) if trial["test_first"] else (reference, test)))

        shown = {**STRONGER, "done": trial["trial"], "total": TRIALS_MOST}
        _, columns = self._person.answer(lambda: [(None, vibration(), FEEL)], shown, self._is_whole)
        return {**columns, "reference_dbfs": self.reference_dbfs}

    def _is_whole(self, played: Played) -> bool:
        """Return whether protection changed nothing; else lower the level."""
        if played.protection_db <= LIMITED_DB or self.reference_dbfs <= START_DBFS:
            return True
        self.reference_dbfs = max(START_DBFS, self.reference_dbfs - STEP_DB)
        return False


def tones(*parts: tuple[float, float]) -> Float32Array:
    """Return vibrations one after the other, (frames, 1) at 48 kHz. parts: Hz and dBFS of each."""
    time_s = np.arange(round(TONE_S * RATE_HZ)) / RATE_HZ
    edges = tukey(time_s.size, 2.0 * EDGE_S / TONE_S)
    pause, edge = (np.zeros(round(s * RATE_HZ)) for s in (PAUSE_S, EDGE_S))
    waves = [db_to_amplitude(db) * edges * np.sin(math.tau * hz * time_s) for hz, db in parts]
    between = [piece for wave in waves for piece in (wave, pause)][:-1]
    # the player fades the first and last 50 ms
    return np.concatenate((edge, *between, edge)).astype(np.float32)[:, None]


class FitSession:
    """One fit; implements `Script`. `posterior` is what its answers say.

    seed: of orders and catch trials. most: number of trials that is allowed, up to TRIALS_MOST.
    """

    def __init__(
        self, sitter: SimulatedSitter | FittedPerson, seed: int, most: int = TRIALS_MOST
    ) -> None:
        self._sitter, self._seed, self._most = sitter, seed, min(most, TRIALS_MOST)
        self.posterior, self._taken = CurvePosterior(), 0

    @property
    def refusal(self) -> str:
        """Why the answers cannot be used, or ""."""
        if self.posterior.catch_evidence < GUESSED:
            return f"too many comparisons of one frequency, {CATCH_DB:g} dB apart, were wrong"
        guessed = "the answers contradict each other, as guesses would"
        return guessed if self.posterior.evidence < GUESSED else ""

    def next_trial(self) -> tuple[Trial, Trial] | None:
        """Return the trial to play next, twice; None if the fit is over."""
        number, is_sure = self._taken, self.posterior.catch_evidence >= SURE
        is_known = self.posterior.uncertainty_db.max() < ENOUGH_DB
        if number >= self._most or (is_known and is_sure):
            return None
        rng, headroom_db = np.random.default_rng([self._seed, number]), self._sitter.headroom_db
        test_first, louder = (bool(flip) for flip in rng.integers(0, 2, 2))
        block, place = divmod(number, BLOCK)
        is_catch = place == np.random.default_rng([self._seed, block, BLOCK]).integers(1, BLOCK)
        if is_catch or (number >= self._most - CATCHES_LAST and not is_sure):
            is_louder = louder and headroom_db >= CATCH_DB
            hz, level_db = REFERENCE_HZ, CATCH_DB if is_louder else -CATCH_DB
        else:
            hz, level_db = self.posterior.next_trial(headroom_db)
        trial = {"trial": number, "hz": hz, "level_db": level_db, "test_first": test_first}
        return trial, trial

    def take(self, row: Mapping[str, Any]) -> None:
        """Learn from a recorded answer."""
        is_stronger = float((row["answer"] == "first") == row["test_first"])
        stronger = 0.5 if row["answer"] == UNKNOWN[0] else is_stronger
        self.posterior.add(row["hz"], row["level_db"], stronger)
        self._taken += 1

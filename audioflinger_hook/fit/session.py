"""The trials of one fit: chooses them, learns from them, and tells whether they are guesses."""

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from audioflinger_hook.fit.curve import REFERENCE_HZ, TEST_HZ, CurvePosterior
from audioflinger_hook.trials.record import Rows, run

TRIALS_MOST, TRIALS_A_MINUTE = 60, 20
ENOUGH_DB = 1.0  # the fit ends when no frequency is less certain than this
BLOCK = 7  # one trial of each block is a catch trial
CATCH_DB = 12.0  # level difference of a catch trial, whose two frequencies are the same
CATCHES_LAST = 8  # of the last trials, as many are catch trials as needed to reach SURE
SURE = 3.0  # evidence of the catch trials, relative to guessing, natural logarithm
GUESSED = 1.0  # with less evidence, the answers count as guessed

DESIGN = {"version": 1, "test_hz": TEST_HZ.tolist(), "reference_hz": REFERENCE_HZ}
FIRST, SECOND, UNKNOWN = "first", "second", "unknown"

Trial = Mapping[str, Any]
"""The columns of a trial.

trial: number from 0. hz, level_db: frequency of the test, and its level relative to the reference.
catch: whether the test has the reference's frequency. test_first: whether the test is first."""


class Sitter(Protocol):
    """Whoever compares the vibrations: a person, or a simulation.

    headroom_db: highest level of a test, in dB relative to the reference. answer: returns
    {"answer": FIRST, SECOND or UNKNOWN}, and more columns.
    """

    @property
    def headroom_db(self) -> float: ...  # noqa: D102

    def answer(self, trial: Trial) -> Mapping[str, Any]: ...  # noqa: D102


class FitSession:
    """One fit, which goes on with the trials that its record already has; implements `Script`.

    posterior: what the answers say. catches, wrong: number of catch trials, and of wrong answers.
    record: its header has the seed of orders and catch trials, "seed". trials_most: their number.
    """

    def __init__(self, record: Rows, sitter: Sitter, trials_most: int = TRIALS_MOST) -> None:
        self.record, self._sitter, self._most = record, sitter, trials_most
        self.posterior, self.catches, self.wrong = CurvePosterior(), 0, 0
        self._taken, self._seed = 0, int(record.header["seed"])

    @property
    def refusal(self) -> str:
        """Why the answers cannot be used, or ""."""
        if self.posterior.catch_evidence < GUESSED:
            clear = f"of {self.catches} comparisons {CATCH_DB:g} dB apart, {self.wrong} were wrong"
            return f"{clear} or not decided" if self.wrong else f"only {clear}"
        guessed = "the answers contradict each other, as guesses would"
        return guessed if self.posterior.evidence < GUESSED else ""

    def run(self) -> Iterator[Mapping[str, Any]]:
        """Ask until the fit is over; yield each row after it is on the disk.

        WriteError: the disk is full. All errors of the sitter pass through.
        """
        return run(self.record, self, self._sitter.answer)

    def next_trial(self) -> tuple[Trial, Trial] | None:
        """Return the trial to play next, twice; None if the fit is over."""
        number, is_sure = self._taken, self.posterior.catch_evidence >= SURE
        is_known = self.posterior.uncertainty_db.max() < ENOUGH_DB
        if number >= self._most or (is_known and is_sure):
            return None
        random = np.random.default_rng([self._seed, number])
        test_first, louder = (bool(flip) for flip in random.integers(0, 2, 2))
        block, place = divmod(number, BLOCK)
        catch_at = np.random.default_rng([self._seed, block, BLOCK]).integers(1, BLOCK)
        headroom_db, hz = self._sitter.headroom_db, REFERENCE_HZ
        is_late = number >= self._most - CATCHES_LAST
        if catch := place == catch_at or (is_late and not is_sure):
            level_db = CATCH_DB if louder and headroom_db >= CATCH_DB else -CATCH_DB
        else:
            index, level_db = self.posterior.next_trial(headroom_db)
            hz = float(TEST_HZ[index])
        trial = {"trial": number, "hz": hz, "level_db": level_db, "catch": bool(catch)}
        trial |= {"test_first": test_first}
        return trial, trial

    def take(self, row: Mapping[str, Any]) -> None:
        """Learn from a recorded answer."""
        is_first = float((row["answer"] == FIRST) == row["test_first"])
        stronger = 0.5 if row["answer"] == UNKNOWN else is_first
        index = None if row["catch"] else int(np.argmin(np.abs(TEST_HZ - row["hz"])))
        self.posterior.add(index, row["level_db"], stronger)
        self._taken += 1
        self.catches += row["catch"]
        self.wrong += row["catch"] and stronger != float(row["level_db"] > 0.0)

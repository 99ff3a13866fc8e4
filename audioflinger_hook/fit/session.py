"""The trials of one fit: chooses them, records the answers, and tells whether they are guesses."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from audioflinger_hook.fit.curve import REFERENCE_HZ, TEST_HZ, CurvePosterior, Floats
from audioflinger_hook.trials import session
from audioflinger_hook.trials.record import Rows, design_digest

TRIALS_MOST, TRIALS_A_MINUTE = 60, 20
ENOUGH_DB = 1.0  # the fit ends when no frequency is less certain than this
BLOCK = 7  # one trial of each block is a catch trial
CATCH_DB = 12.0  # level difference of a catch trial, whose two frequencies are the same
CATCHES_LAST = 8  # of the last trials, as many are catch trials as needed to reach SURE
SURE = 3.0  # evidence of the catch trials, relative to guessing, natural logarithm
GUESSED = 1.0  # with less evidence, the answers count as guessed

FIRST, SECOND, UNKNOWN = "first", "second", "unknown"


@dataclass(frozen=True)
class Trial:
    """Two vibrations to compare.

    number: from 0. index: of the test in TEST_HZ; None for a catch trial at REFERENCE_HZ.
    level_db: level of the test relative to the reference. test_first: whether the test is first.
    """

    number: int
    index: int | None
    level_db: float
    test_first: bool

    @property
    def hz(self) -> float:
        """Frequency of the test."""
        return REFERENCE_HZ if self.index is None else float(TEST_HZ[self.index])


class Sitter(Protocol):
    """Whoever compares the vibrations: a person, or a simulation."""

    @property
    def headroom_db(self) -> float:
        """Highest level of a test, in dB relative to the reference."""
        ...

    def answer(self, trial: Trial) -> Mapping[str, Any]:
        """Return {"answer": FIRST, SECOND or UNKNOWN}, and more entries for the record."""
        ...


def design_of(**facts: Any) -> str:
    """Return the SHA-256 of a fit's design. facts: what must not change while a fit goes on."""
    rules = {"version": 1, "test_hz": TEST_HZ.tolist(), "reference_hz": REFERENCE_HZ}
    return design_digest({**rules, **facts})


class FitSession:
    """One fit, which goes on with the trials that its record already has.

    posterior: what the answers say. catches, wrong: number of catch trials, and of wrong answers.

    record: its header has the seed of orders and catch trials, "seed". It implements `Script`.
    sitter: compares the vibrations. trials_most: largest number of trials.
    """

    def __init__(self, record: Rows, sitter: Sitter, trials_most: int = TRIALS_MOST) -> None:
        self.record, self.trials_most = record, trials_most
        self.posterior = CurvePosterior()
        self.catches = self.wrong = 0
        self._sitter = sitter
        self._seed = int(record.header["seed"])
        self._progress: Callable[[int, Floats], None] = lambda count, db: None

    @property
    def is_over(self) -> bool:
        """Whether the curve is certain enough, or the last trial is done."""
        count = len(self.record.trials)
        certain = self.posterior.uncertainty_db.max() < ENOUGH_DB
        return count >= self.trials_most or (
            bool(certain) and self.posterior.catch_evidence >= SURE
        )

    @property
    def refusal(self) -> str:
        """Why the answers cannot be used, or ""."""
        if self.posterior.catch_evidence < GUESSED:
            clear = f"of {self.catches} comparisons {CATCH_DB:g} dB apart, {self.wrong} were wrong"
            return f"{clear} or not decided" if self.wrong else f"only {clear}"
        if self.posterior.evidence < GUESSED:
            return "the answers contradict each other, as guesses would"
        return ""

    def run(self, progress: Callable[[int, Floats], None] | None = None) -> None:
        """Ask until the fit is over. Each answer is on the disk before the next trial.

        progress: called before each trial with the number of trials done and the uncertainties in
        dB. WriteError: the disk is full. All errors of the sitter pass through.
        """
        self._progress = progress or self._progress
        for _ in session.run(self.record, self, self._sitter.answer):
            pass

    def next_trial(self) -> tuple[Trial, dict[str, Any]] | None:
        """Return the trial to play next, and its columns of the record; None if it is over."""
        if self.is_over:
            return None
        count = len(self.record.trials)
        self._progress(count, self.posterior.uncertainty_db)
        trial = self._trial(count)
        columns = {"trial": count, "hz": trial.hz, "level_db": trial.level_db}
        columns |= {"catch": trial.index is None, "test_first": trial.test_first}
        return trial, columns

    def _trial(self, count: int) -> Trial:
        random = np.random.default_rng([self._seed, count])
        test_first, louder = (bool(flip) for flip in random.integers(0, 2, 2))
        block, place = divmod(count, BLOCK)
        catch_at = np.random.default_rng([self._seed, block, BLOCK]).integers(1, BLOCK)
        is_late = count >= self.trials_most - CATCHES_LAST
        if place == catch_at or (is_late and self.posterior.catch_evidence < SURE):
            louder &= self._sitter.headroom_db >= CATCH_DB
            return Trial(count, None, CATCH_DB if louder else -CATCH_DB, test_first)
        return Trial(count, *self.posterior.next_trial(self._sitter.headroom_db), test_first)

    def take(self, row: Mapping[str, Any]) -> None:
        """Learn from a recorded answer."""
        stronger = 0.5
        if row["answer"] != UNKNOWN:
            stronger = float((row["answer"] == FIRST) == row["test_first"])
        index = None if row["catch"] else int(np.argmin(np.abs(TEST_HZ - row["hz"])))
        self.posterior.add(index, row["level_db"], stronger)
        if row["catch"]:
            self.catches += 1
            self.wrong += stronger != float(row["level_db"] > 0.0)

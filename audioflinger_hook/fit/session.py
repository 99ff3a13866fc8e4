"""The trials of a fit, and who answers them: a person or a simulated one.

A trial has the columns trial (from 0), hz and level_db (of the test; relative to the reference),
and test_first. A sitter has `answer`, which returns the column answer for a trial, and
`reference_dbfs`, the level of the reference.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.signal.windows import tukey
from scipy.special import ndtr

from audioflinger_hook.config.kinds import Curve, curve_text
from audioflinger_hook.fit import PROTOCOL as P
from audioflinger_hook.fit.curve import CurvePosterior
from audioflinger_hook.transform.design.strength import interpolated_db
from audioflinger_hook.trials.page import screen
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import Played
from device.units import Float32Array, db_to_amplitude
from device.values import Described, Number

Trial = Mapping[str, Any]
LEVEL, STRONGER, FEEL = (screen(**shown) for shown in (P.level, P.stronger, P.feel))


@dataclass(frozen=True)
class SimulatedSitter(Described):
    """A simulated person. An answer depends on `seed` and on its own trial only."""

    curve_db: Annotated[Mapping[Any, float], Curve("sensitivity in dB by Hz")]
    jnd_db: Annotated[float, Number("deviation of the decision noise", 1e-3, 1e6, "dB")] = 1.5
    lapse: Annotated[float, Number("share of answers that are guessed", 0.0, 1.0)] = 0.0
    seed: Annotated[int, Number("seed of noise and guesses", 0, 2**53, whole=True)] = 0
    reference_dbfs = -math.inf

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Answer a trial."""
        hz = np.array([trial["hz"], P.reference_hz])
        test_db, reference_db = interpolated_db(curve_text(self.curve_db), hz)
        stronger = ndtr((test_db - reference_db + trial["level_db"]) / self.jnd_db)
        chance = 0.5 * self.lapse + (1.0 - self.lapse) * stronger
        # not from the stream of [seed, number], which draws the trial itself
        is_weaker = np.random.default_rng([self.seed, trial["trial"], 7]).random() > chance
        return {"answer": "second" if is_weaker == trial["test_first"] else "first"}


class FittedPerson:
    """A person, who first raises the level of the reference, also after an interruption."""

    def __init__(self, person: Person) -> None:
        self._person, said, self.reference_dbfs = person, "", P.start_dbfs
        while said != "good":
            level_db = self.reference_dbfs + P.step_db.get(said, 0.0)
            self.reference_dbfs = min(max(P.start_dbfs, level_db), P.most_dbfs)
            self._is_whole(person.play(None, tones((P.reference_hz, self.reference_dbfs)), FEEL))
            said = str(person.answers.ask(LEVEL).value)

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Play a trial until it is whole and the person answers; add the reference's level."""

        def vibration() -> Float32Array:
            test = trial["hz"], self.reference_dbfs + trial["level_db"]
            reference = P.reference_hz, self.reference_dbfs
            return tones(*((test, reference) if trial["test_first"] else (reference, test)))

        shown = {**STRONGER, "done": trial["trial"], "total": P.trials}
        _, columns = self._person.answer(lambda: [(None, vibration(), FEEL)], shown, self._is_whole)
        return {**columns, "reference_dbfs": self.reference_dbfs}

    def _is_whole(self, played: Played) -> bool:
        """Return whether protection changed nothing; else lower the level."""
        if played.protection_db <= P.limited_db or self.reference_dbfs <= P.start_dbfs:
            return True
        self.reference_dbfs = max(P.start_dbfs, self.reference_dbfs - P.step_db["louder"])
        return False


Sitter = SimulatedSitter | FittedPerson


def tones(*parts: tuple[float, float]) -> Float32Array:
    """Return vibrations one after the other, (frames, 1) at 48 kHz. parts: Hz and dBFS of each."""
    time_s = np.arange(round(P.tone_s * P.rate_hz)) / P.rate_hz
    edges = tukey(time_s.size, 2.0 * P.edge_s / P.tone_s)
    pause, edge = (np.zeros(round(s * P.rate_hz)) for s in (P.pause_s, P.edge_s))
    waves = [db_to_amplitude(db) * edges * np.sin(math.tau * hz * time_s) for hz, db in parts]
    between = [piece for wave in waves for piece in (wave, pause)][:-1]
    # the player fades the first and last 50 ms
    return np.concatenate((edge, *between, edge)).astype(np.float32)[:, None]


class FitSession:
    """One fit; implements `Script`. `posterior` is what its answers say.

    seed: of orders and catch trials. most: largest number of trials, up to the protocol's.
    """

    def __init__(self, sitter: Sitter, seed: int, most: int = P.trials) -> None:
        self._sitter, self._seed, self._most = sitter, seed, min(most, P.trials)
        self.posterior, self._taken = CurvePosterior(), 0

    @property
    def refusal(self) -> str:
        """Why the answers cannot be used, or ""."""
        if self.posterior.catch_evidence < P.guessed:
            return f"too many comparisons of one frequency, {P.catch_db:g} dB apart, were wrong"
        guessed = "the answers contradict each other, as guesses would"
        return guessed if self.posterior.evidence < P.guessed else ""

    def next_trial(self) -> tuple[Trial, Trial] | None:
        """Return the trial to play next, twice; None if the fit is over."""
        number, is_sure = self._taken, self.posterior.catch_evidence >= P.sure
        is_known = self.posterior.uncertainty_db.max() < P.enough_db
        if number >= self._most or (is_known and is_sure):
            return None
        test_first, louder = np.random.default_rng([self._seed, number]).integers(0, 2, 2)
        block, place = divmod(number, P.block)
        is_catch = place == np.random.default_rng([self._seed, block, P.block]).integers(1, P.block)
        most_db = P.peak_dbfs - self._sitter.reference_dbfs
        hz, level_db = self.posterior.next_trial()
        if is_catch or (number >= self._most - P.catches_last and not is_sure):
            hz = P.reference_hz
            level_db = P.catch_db if louder and P.catch_db <= most_db else -P.catch_db
        trial = {"trial": number, "hz": hz, "level_db": min(level_db, most_db)}
        trial |= {"test_first": bool(test_first)}
        return trial, trial

    def take(self, row: Mapping[str, Any]) -> None:
        """Learn from a recorded answer."""
        is_stronger = float((row["answer"] == "first") == row["test_first"])
        stronger = 0.5 if row["answer"] == "unknown" else is_stronger
        self.posterior.add(row["hz"], row["level_db"], stronger)
        self._taken += 1

"""A simulated person with a known curve, who answers in place of a person."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.special import ndtr

from audioflinger_hook.fit.curve import REFERENCE_HZ
from audioflinger_hook.fit.session import FIRST, SECOND, Trial
from audioflinger_hook.trials.simulated import drawn, people_file, with_lapses
from device.errors import UsageError
from device.values import Described, Number, Refusal, Text, no_such

HZ, DB = Number("frequency", 10.0, 1_000.0, "Hz"), Number("sensitivity", -100.0, 100.0, "dB")
NUMBER = r"\d{1,5}(\.\d*)?"
EXAMPLE = '{"curve_db": {"25": -6.0, "70": 0.0, "200": 4.0}, "jnd_db": 1.5}'


@dataclass(frozen=True)
class Curve(Text):
    """A table of sensitivities in dB, with frequencies in Hz as keys."""

    grammar: str = f'{{"HZ": DB, ...}}, frequencies of {HZ.allowed}, {DB.allowed}'

    def refuse(self, value: object) -> Refusal | None:
        """Refuse an empty table, and name each wrong frequency or sensitivity."""
        if not isinstance(value, dict) or not value:
            return Refusal("is not a table of frequencies", self.allowed)
        hz = {one: float(one) if re.fullmatch(NUMBER, str(one)) else None for one in value}
        found = [
            f"has {json.dumps(text)[:40]}: {json.dumps(level_db)[:40]}"
            for text, level_db in value.items()
            if HZ.refuse(hz[text]) or DB.refuse(level_db)
        ]
        found += ["has a frequency twice"] if not found and len({*hz.values()}) < len(hz) else []
        return Refusal(", ".join(found), self.allowed) if found else None

    def typed(self, value: Any) -> Any:
        """Return the table with ascending frequencies as numbers."""
        return dict(sorted((float(hz), float(level_db)) for hz, level_db in value.items()))


@dataclass(frozen=True)
class SimulatedSitter(Described):
    """A simulated person, interpolated in log frequency; implements `Sitter`.

    An answer depends on `seed` and on its own trial only. UsageError: see `Described`.
    """

    curve_db: Annotated[Mapping[Any, float], Curve("sensitivity in dB by frequency in Hz")]
    jnd_db: Annotated[
        float, Number("standard deviation of the decision noise", 1e-3, 1e6, "dB")
    ] = 1.5
    lapse: Annotated[float, Number("share of answers that are guessed", 0.0, 1.0)] = 0.0
    seed: Annotated[int, Number("seed of noise and guesses", 0, 2**53, whole=True)] = 0
    headroom_db = np.inf

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Return the answer to a trial."""
        octaves, level_db = np.log2([*self.curve_db]), [*self.curve_db.values()]
        test, reference = np.interp(np.log2([trial["hz"], REFERENCE_HZ]), octaves, level_db)
        stronger = ndtr((test - reference + trial["level_db"]) / self.jnd_db)
        chances = with_lapses(np.array([stronger, 1.0 - stronger]), self.lapse)
        # apart from the session's stream of [seed, number], which draws the trial itself
        is_weaker = drawn(chances, np.random.default_rng([self.seed, trial["trial"], 7]))
        return {"answer": SECOND if is_weaker == trial["test_first"] else FIRST}


def read_sitter(path: Path) -> SimulatedSitter:
    """Read a file such as EXAMPLE. UsageError: it has mistakes; the message names all of them."""
    try:
        found = people_file(path)
    except UsageError as error:
        raise UsageError(f"{error}; allowed: {EXAMPLE}") from None
    known = SimulatedSitter.DESCRIPTIONS
    wrong = [no_such("key", key[:40], known, "") for key in found if key not in known]
    refused = SimulatedSitter.refusals(found).items()
    if wrong := [*wrong, *(f"{name} {refusal}" for name, refusal in refused)]:
        raise UsageError(f"the sitter {path}: {'; '.join(wrong)}")
    return SimulatedSitter.from_values(found)

"""A simulated person with a known curve, who answers in place of a person."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.fit.curve import REFERENCE_HZ
from audioflinger_hook.fit.session import FIRST, SECOND, Trial
from device.errors import UsageError
from device.values import Number, Refusal, nearest

HZ = Number("frequency", 10.0, 1_000.0, "Hz")
DB = Number("sensitivity", -100.0, 100.0, "dB")
KEYS = {
    "jnd_db": Number("standard deviation of the decision noise", 1e-3, 1e6, "dB"),
    "lapse": Number("share of answers that are guessed", 0.0, 1.0),
    "seed": Number("seed of noise and lapses", 0, 2**63, whole=True),
}
DEFAULTS = {"jnd_db": 1.5, "lapse": 0.0, "seed": 0}
EXAMPLE = '{"curve_db": {"25": -6.0, "70": 0.0, "200": 4.0}, "jnd_db": 1.5}'


@dataclass(frozen=True)
class SimulatedSitter:
    """A person with the sensitivity `curve_db`, interpolated in log frequency; see `Sitter`.

    curve_db: dB by frequency in Hz, ascending. jnd_db: standard deviation of the decision noise.
    lapse: share of answers that are guessed. seed: of noise and lapses; a trial's answer depends on
    no other trial.
    """

    curve_db: Mapping[float, float]
    jnd_db: float
    lapse: float
    seed: int
    headroom_db: float = math.inf

    def answer(self, trial: Trial) -> dict[str, Any]:
        """Return the answer to a trial."""
        octaves = np.log2([*self.curve_db])
        felt_db = np.interp(np.log2([trial.hz, REFERENCE_HZ]), octaves, [*self.curve_db.values()])
        random = np.random.default_rng([self.seed, trial.number])
        difference_db = felt_db[0] - felt_db[1] + trial.level_db
        stronger = bool(difference_db + self.jnd_db * random.normal() > 0.0)
        if random.random() < self.lapse:
            stronger = bool(random.integers(0, 2))
        return {"answer": FIRST if stronger == trial.test_first else SECOND}


def read_sitter(path: Path) -> SimulatedSitter:
    """Read a file such as EXAMPLE. UsageError: it has mistakes; the message names all of them."""
    try:
        known = json.loads(path.read_text("utf-8"), object_pairs_hook=_unique)
    except OSError as error:
        raise UsageError(
            f"cannot read the sitter {path}: {error.strerror}; allowed: a file such as {EXAMPLE}"
        ) from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"the sitter {path} is not JSON ({error}); allowed: {EXAMPLE}") from None
    if not isinstance(known, dict):
        raise UsageError(f"the sitter {path} is not a JSON object; allowed: {EXAMPLE}")
    mistakes, curve_db = _curve(known.get("curve_db"))
    for name in known.keys() - {"curve_db", *KEYS}:
        allowed = ", ".join(("curve_db", *KEYS))
        guess = nearest(name, ("curve_db", *KEYS))
        mistakes.append(f"{name[:40]!r} {Refusal('is not known', allowed, guess)}")
    values = {name: known.get(name, DEFAULTS[name]) for name in KEYS}
    for name, described in KEYS.items():
        if refusal := described.refuse(values[name]):
            mistakes.append(f"{name}={_shown(values[name])} {refusal}")
    if mistakes:
        raise UsageError(f"the sitter {path}: {'; '.join(mistakes)}")
    return SimulatedSitter(curve_db, **values)


def _curve(points: object) -> tuple[list[str], dict[float, float]]:
    """Return all mistakes of `curve_db`, and the sensitivities in dB by ascending frequency."""
    if not isinstance(points, dict) or not points:
        wrong = "is missing" if points is None else "is not a table of frequencies"
        return [f'curve_db {wrong}; allowed: {{"HZ": DB, ...}}, at least one'], {}
    mistakes, found = [], {}
    for text, level_db in points.items():
        try:
            hz = float(text)
        except ValueError:
            hz = math.nan
        for value, described in ((hz, HZ), (level_db, DB)):
            refusal = described.refuse(value)
            if refusal and math.isnan(hz) and described is HZ:
                refusal = Refusal("is not a frequency", HZ.allowed)
            if refusal:
                what = f"frequency {text[:40]!r}" if described is HZ else f"{text[:40]!r} Hz: "
                shown = "" if described is HZ else _shown(value)
                mistakes.append(f"curve_db: {what}{shown} {refusal}")
        if hz in found:
            mistakes.append(f"curve_db: {hz:g} Hz is there twice; allowed: once")
        found[hz] = level_db
    return mistakes, dict(sorted(found.items()))


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object. ValueError: a key is there twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(key for key in keys if keys.count(key) > 1)[:40]!r} is twice")
    return found


def _shown(value: object) -> str:
    return json.dumps(value)[:40]

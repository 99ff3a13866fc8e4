"""Rig files: a rig in TOML, every value with its unit in its name and, if known, its source.

    [actuator]
    resonance_hz = { value = 90.0, given = "the paper: about 90 Hz" }
    q_mechanical = { value = 8.0, assumed = "a rubber suspension" }
    force_factor_n_per_a = { value = 9.8, measured = "impedance", interval = [9.6, 10.0] }
    inductance_h = 1e-3

Each stage is a table, named as the fields of `Rig`. A value may stand alone; the shipped rigs state
the source of each. `[actuator]` may also state derived values (stiffness_n_per_m,
damping_n_s_per_m, q_electrical, q_total), which must then agree with the rest.
"""

import difflib
import math
import tomllib
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

from device.errors import UsageError
from device.rig.parameters import ActuatorParameters, Stage
from device.rig.rig import SOURCE_KINDS, Rig, Source, find_contradictions

SUFFIX = ".toml"
SHIPPED = ("paper", "consumer")
_NAMES = ", ".join(SHIPPED)

STAGES: dict[str, type[Stage]] = {
    stage.name: kind
    for stage in fields(Rig)
    for kind in (stage.type, *get_args(stage.type))
    if isinstance(kind, type) and issubclass(kind, Stage)
}
REQUIRED = ("dac", "amplifier", "actuator")
DERIVED = ("stiffness_n_per_m", "damping_n_s_per_m", "q_electrical", "q_total")
AGREEMENT = 0.02
"""Largest deviation of a stated derived value, which usually has two or three digits."""


def read_rig(path: str | Path) -> Rig:
    """Return the rig that a file describes.

    path: a TOML file. Without `name` in it, the rig takes the file's name.
    UsageError: the file cannot be read or is not TOML. Or values are missing, unknown, of the wrong
    type, out of range or contradictory; the message names all of them.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise UsageError(
            f"cannot read the rig file {path}: {reason}; check it, or choose one of: {_NAMES}"
        ) from None
    return parse_rig(text, path.stem, str(path))


def parse_rig(text: str, name: str, origin: str) -> Rig:
    """Return the rig that a TOML text describes; origin names the text in messages."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"the rig file {origin} is not TOML: {error}; correct it") from None
    reading = _Reading()
    stages = reading.read(document)
    stated = document.get("name", name)
    if not (isinstance(stated, str) and stated):
        reading.wrong.append(f"name={stated!r} must be a word")
    reading.wrong += find_contradictions(stages)
    if reading.wrong:
        raise UsageError(f"the rig file {origin}: {'; '.join(reading.wrong)}; correct the file")
    return Rig(name=stated, sources=tuple(reading.sources), **stages)


@dataclass
class _Reading:
    """The sources and problems found in one file."""

    wrong: list[str] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)

    def read(self, document: dict[str, Any]) -> dict[str, Any]:
        """Return every valid stage by its name."""
        self._refuse_unknown("", document, [*STAGES, "name", "description"])
        stages: dict[str, Any] = {}
        for name, kind in STAGES.items():
            if name not in document:
                if name in REQUIRED:
                    self.wrong.append(f"[{name}] is missing")
            elif not isinstance(document[name], dict):
                self.wrong.append(f"{name}={document[name]!r} must be a table, [{name}]")
            elif stage := self._stage(name, kind, document[name]):
                stages[name] = stage
        return stages

    def _stage(self, name: str, kind: type[Stage], table: dict[str, Any]) -> Stage | None:
        before = len(self.wrong)
        known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
        following = DERIVED if name == "actuator" else ()
        every = [*known, *following]
        self._refuse_unknown(f"{name}.", table, every)
        values = {k: self._value(f"{name}.{k}", table[k]) for k in every if k in table}
        for key, description in known.items():
            if key not in values and description.default is MISSING:
                self.wrong.append(f"{name}.{key} is missing")
        stated = {key: values.pop(key) for key in following if key in values}
        self.wrong += [f"{name}.{problem}" for problem in kind.problems(values)]
        if len(self.wrong) > before:
            return None
        are_floats = {key: get_args(known[key].type)[0] is float for key in values}
        stage = kind(**{k: float(v) if are_floats[k] else v for k, v in values.items()})
        if isinstance(stage, ActuatorParameters):
            self._compare(stage, stated)
        return stage

    def _value(self, parameter: str, stated: object) -> Any:
        """Return the bare value and keep its source, if there is one."""
        if not isinstance(stated, dict):
            return stated
        value, interval = stated.get("value", math.nan), stated.get("interval")
        kinds = [kind for kind in SOURCE_KINDS if kind in stated]
        unknown = set(stated) - {"value", "interval", *SOURCE_KINDS}
        if "value" not in stated or len(kinds) != 1 or unknown:
            self.wrong.append(
                f"{parameter} must be a number or {{ value = ..., KIND = 'why' }} with one KIND "
                f"of {', '.join(SOURCE_KINDS)}"
            )
            return value
        if interval is not None and not _is_interval(interval, value):
            self.wrong.append(f"{parameter}: interval={interval!r} must be [low, high] around it")
            interval = None
        bounds = (float(interval[0]), float(interval[1])) if interval else None
        self.sources.append(Source(parameter, kinds[0], str(stated[kinds[0]]), bounds))
        return value

    def _compare(self, actuator: ActuatorParameters, stated: dict[str, Any]) -> None:
        for key, value in stated.items():
            follows = getattr(actuator, key)
            follows = follows() if callable(follows) else follows
            if not (isinstance(value, float) and abs(value / follows - 1.0) <= AGREEMENT):
                self.wrong.append(
                    f"actuator.{key}={value!r} contradicts the rest, from which {follows:.4g} "
                    "follows: correct one of them, or leave it out"
                )

    def _refuse_unknown(self, prefix: str, table: Iterable[str], known: list[str]) -> None:
        for key in table:
            if key not in known:
                near = difflib.get_close_matches(key, known, 1)
                hint = f", did you mean {near[0]}?" if near else ""
                self.wrong.append(f"{prefix}{key} is unknown{hint}")


def _is_interval(interval: Any, value: Any) -> bool:
    try:
        low, high = interval
        return bool(low <= value <= high)
    except (TypeError, ValueError):
        return False


def _shipped(name: str) -> Rig:
    text = files("device.rig").joinpath(name + SUFFIX).read_text(encoding="utf-8")
    return parse_rig(text, name, f"{name}{SUFFIX} of this package")


_RIGS = {name: _shipped(name) for name in SHIPPED}
PAPER, CONSUMER = _RIGS["paper"], _RIGS["consumer"]


def rig_by_name(name: str) -> Rig:
    """Return the shipped rig of that name, or the rig in a file.

    name: a shipped rig's name, or a path that ends in .toml.
    UsageError: no rig has that name; the message lists the names. Or the file is invalid, see
    `read_rig`.
    """
    if name in _RIGS:
        return _RIGS[name]
    if name.endswith(SUFFIX):
        return read_rig(name)
    raise UsageError(f"no rig is named {name!r}; choose one of: {_NAMES}; or a file, NAME{SUFFIX}")

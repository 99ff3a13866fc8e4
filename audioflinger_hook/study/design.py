"""The design of a study: reads `design.toml`, and finds all mistakes in it at once.

`built_in/design.schema.json` describes its keys, and `built_in/paradigms.toml` the paradigms.
"""

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import soundfile

from audioflinger_hook.baselines import BASELINES
from audioflinger_hook.config import toml_text
from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.config.toml_text import Mistake, printable
from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.trials.record import design_digest
from device.errors import UsageError, not_installed
from device.values import nearest, no_such

DESIGN, HOURS_MAX, SOUND_S = "design.toml", 8.0, (0.1, 100.0)
GAP_S = 0.4  # silence between the two intervals of a trial
BUILT_IN = files("audioflinger_hook.study") / "built_in"
STUDY, CONDITION, QUESTION = "study", "condition", "question"
SCHEMAS = {STUDY: json.loads((BUILT_IN / "design.schema.json").read_text())}
for _table in (CONDITION, QUESTION):
    SCHEMAS[_table] = SCHEMAS[STUDY]["properties"].pop(_table)["items"]
PARADIGMS: dict[str, dict[str, Any]] = tomllib.loads((BUILT_IN / "paradigms.toml").read_text())
DRAFT = "http://json-schema.org/draft-04/schema#"  # in later drafts, 2.0 is an integer
NONE = "none"
METHODS: dict[str, Callable[[int, int], Any] | None] = {NONE: None, **BASELINES} | {
    name: partial(HapticTransform, parameters=parameters_of(name)) for name in PROFILES
}
"""What computes vibration from sound: called with the rate and the channels; None: nothing."""


class MistakesError(UsageError):
    """The mistakes of a design: each of `args` is one."""


class Question(SimpleNamespace):
    """A question to the participants: the keys of its [[question]], and what follows from them."""

    @property
    def kind(self) -> Mapping[str, Any]:
        """The paradigm's row of `paradigms.toml`."""
        row = PARADIGMS[self.paradigm]
        return {**row, **row.get(self.judgement, {})}

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """The tested condition of each kind of trial, and the other one; "" for one interval."""
        if self.paradigm == "preference":
            return list(combinations(self.conditions, 2))
        other = {"threshold": NONE, "rating": self.reference, "equal": self.reference}
        against = other.get(self.paradigm, "")
        tested = {*self.conditions} - {against if self.paradigm == "equal" else ""}
        return [(name, against) for name in self.conditions if name in tested]

    @property
    def delays(self) -> Sequence[float]:
        """The delays in ms of each kind of trial."""
        return self.offsets_ms if self.kind["varies"] == "delay" else (0.0,)


@dataclass(frozen=True)
class Design:
    """A study, with the keys of the tables in `design.toml`. digest: SHA-256 of its bytes."""

    folder: Path
    digest: str
    study: SimpleNamespace
    conditions: Mapping[str, SimpleNamespace]
    questions: Mapping[str, Question]

    @property
    def hours(self) -> float:
        """Expected duration of one participant's session."""
        total_s = 0.0
        for one in self.questions.values():
            sound_s = sum(seconds(self.folder / name) for name in one.stimuli) / len(one.stimuli)
            kinds = len(one.pairs) * len(one.stimuli) * len(one.delays)
            trial_s = one.kind["intervals"] * (sound_s + GAP_S) + GAP_S + self.study.answer_s
            total_s += trial_s * (kinds * one.repeats + self.study.practice)
        return total_s / 3600.0


def vibration_file(folder: Path, method: str, stimulus: str) -> Path | None:
    """Return the file that a condition's method names for a sound, None if it computes."""
    made = method.replace("{stimulus}", Path(stimulus).stem)
    return folder / made if {".", "/"} & {*method} else None


def seconds(path: Path) -> float:
    """Return the duration of a sound file; 0 if it cannot be read."""
    try:
        return float(soundfile.info(path).duration)
    except (OSError, ValueError, soundfile.LibsndfileError):
        return 0.0


def load(folder: Path) -> Design:
    """Return the design in a folder. MistakesError: all its mistakes, by line."""
    if not (folder / DESIGN).exists():
        raise UsageError(f"{folder} has no {DESIGN}; make it: `cushion study new {folder}`")
    content = toml_text.text_of(folder / DESIGN)
    (document, mistakes), lines = toml_text.parse(content), toml_text.lines_of_keys(content)
    if mistakes:  # after an error of syntax, other mistakes are often false
        raise MistakesError(mistakes[0])
    tables: dict[str, Any] = {table: document.pop(table, None) for table in (CONDITION, QUESTION)}
    for table, rows in tables.items():
        if not (isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows)):
            problem, allowed = "is missing: there are zero trials", f"one or more [[{table}]]"
            mistakes.append(Mistake(table, lines.get(table, 0), "", problem, allowed))
            tables[table] = []
    methods = {str(row.get("name")): str(row.get("method")) for row in tables[CONDITION]}
    made: dict[str, dict[str, Any]] = {}
    for table, rows in {STUDY: [document], **tables}.items():
        made[table] = {}
        for number, row in enumerate(rows, 1):
            own = PARADIGMS.get(str(row.get("paradigm")), {}).get("keys", {})
            keys = {key: v | own.get(key, {}) for key, v in SCHEMAS[table]["properties"].items()}
            found = list(_problems(SCHEMAS[table] | {"properties": keys}, row, methods, folder))
            if row.get("name", ()) in [one.get("name") for one in rows[: number - 1]]:
                found.append(("name", f"is a duplicate: an earlier [[{table}]] has this name", ""))
            for key, problem, meant in found:
                path = printable(key if table == STUDY else f"{table}[{number}].{key}")
                line = lines.get(path) or lines.get(path.rpartition(".")[0]) or 0
                allowed = keys[key]["description"] if key in keys else ", ".join(keys)
                value = printable(str(row.get(key, ""))) if key in keys else ""
                mistakes.append(Mistake(path, line, value, problem, allowed, meant))
            if not keys.keys() & {key for key, *_ in found}:
                values = {key: row.get(key, about.get("default")) for key, about in keys.items()}
                kind = Question if table == QUESTION else SimpleNamespace
                made[table][row.get("name", STUDY)] = kind(**values)
    digest = design_digest((folder / DESIGN).read_bytes())
    study = made[STUDY].get(STUDY, SimpleNamespace(practice=0, answer_s=0.0))
    design = Design(folder, digest, study, made[CONDITION], made[QUESTION])
    if (hours := design.hours) > HOURS_MAX:
        problem, allowed = f"takes {hours:.1f} h for each participant", f"at most {HOURS_MAX:g} h"
        mistakes.append(Mistake("this study", 0, "", problem, allowed))
    if mistakes:
        raise MistakesError(*toml_text.listed(sorted(mistakes, key=lambda mistake: mistake.line)))
    return design


def _problems(
    schema: Mapping[str, Any], row: Mapping[str, Any], methods: Mapping[str, str], folder: Path
) -> Iterator[tuple[str, str, str]]:
    """Yield each wrong key of a row, why, and the most similar name. methods: by condition."""
    keys, good = schema["properties"], dict[str, Any]()
    for key in row.keys() - keys.keys():
        yield key, "is an unknown key", nearest(key, keys)
    paradigm = PARADIGMS.get(str(row.get("paradigm")), {"hidden": (), "varies": "nothing"})
    # A level or a delay cannot be judged without vibration; `none` is the other interval.
    varies = paradigm["varies"] != "nothing"
    judged = [name for name, how in methods.items() if not varies or NONE not in (name, how)]
    more: dict[str, Any] = {"conditions": {"items": {"enum": judged}}}
    for key, about in keys.items():
        wanted = about | more.get(key, {})
        if key in row and (problem := why_not(wanted, row[key])):
            words = about.get("examples") or wanted.get("enum", ())
            yield key, problem, nearest(str(row[key]), words)
        elif key in row:
            good[key] = row[key]
        elif key in (*schema["required"], *paradigm["hidden"]):
            yield key, "is missing", ""
        if key == "conditions" and key in good and "parameters" in paradigm:
            more = {name: {"enum": good[key]} for name in paradigm["hidden"]}
            more["effect"] = people_schema(paradigm, good[key])
    for sound in good.get("stimuli", ()):
        if not SOUND_S[0] <= seconds(folder / sound) <= SOUND_S[1]:
            yield "stimuli", f"has {sound!r}, which is not such a file", ""
        for name in good.get("conditions", ()):
            path = vibration_file(folder, methods[name], sound)
            if path and not seconds(path):
                yield "conditions", f"has {name!r}, which needs the file {path}", ""


def people_schema(paradigm: Mapping[str, Any], conditions: Sequence[str]) -> dict[str, Any]:
    """Return the JSON Schema of simulated people's parameters: numbers, or tables by condition."""
    own = {key: (low, high) for key, (_, low, high) in paradigm["parameters"].items()}
    known = {**own, **{f"{key}_spread": (0.0, 1e4) for key in own}, "lapse": (0.0, 1.0)}
    properties = {}
    for key, (low, high) in known.items():
        number = {"type": "number", "minimum": low, "maximum": high}
        by_name = {"properties": dict.fromkeys(conditions, number), "description": "condition"}
        properties[key] = number | by_name | {"type": ["number", "object"]}
    return {"type": "object", "properties": properties, "description": "parameter"}


def why_not(schema: Mapping[str, Any], value: object, *at: str) -> str:
    """Return why a JSON Schema refuses a value, part by part, or "". at: keys that lead to it."""
    where, known = f"{'.'.join(at)}: " if at else "", schema.get("properties")
    if known and isinstance(value, dict):
        kind, unknown = schema["description"], [key for key in value if key not in known]
        wrong = [where + no_such(kind, key, known, "") for key in unknown]
        wrong += [why_not(known[key], value[key], *at, key) for key in value if key in known]
        return "; ".join(filter(None, wrong))
    try:
        import fastjsonschema

        json.dumps(value, allow_nan=False)
        fastjsonschema.compile({"$schema": DRAFT, **schema})(value)
    except ModuleNotFoundError as error:
        raise UsageError(not_installed(str(error.name), "study")) from error
    except fastjsonschema.JsonSchemaValueException as error:
        told = str(error.message).removeprefix(f"{error.name} ")
        item = f"has {error.value!r}, which " if error.value is not value else ""
        return f"{where}{item}{'is unknown' if error.rule == 'pattern' else told}"
    except (TypeError, ValueError) as error:  # a date, or a number that is not finite
        return f"{where}is wrong ({error})"
    return ""

"""Reads `design.toml`, and finds all mistakes in it at once."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from audioflinger_hook.config.toml_text import Mistake, lines_of_keys, parse, printable, text_of
from audioflinger_hook.study.design import (
    DESIGN,
    HOURS_MAX,
    METHODS,
    Condition,
    Design,
    Question,
    Stimulus,
    Study,
)
from audioflinger_hook.trials.record import design_digest
from device.errors import UsageError
from device.values import Described, Refusal, nearest

TABLES = {"stimulus": Stimulus, "condition": Condition, "question": Question}
NEEDS = {"preference": (2, 1), "rating": (3, 1), "equal": (2, 1), "identification": (1, 2)}
"""Least number of conditions and of sounds; of other paradigms 1 and 1."""
HIDDEN = {"rating": ("reference", "anchor"), "equal": ("reference",)}
NEUTRAL = {"conditions": (), "stimuli": (), "repeats": 0}
"""Values in place of refused ones without a default, to find the other mistakes as well."""

Found = Iterator[tuple[str, Any, Refusal]]  # key, value and why it is refused


def load(folder: Path) -> Design:
    """Return the design in a folder. UsageError: it has mistakes; see `check`."""
    design, mistakes = check(folder)
    if mistakes:
        more = f" (and {len(mistakes) - 1} more; see `cushion study check`)" if mistakes[1:] else ""
        raise UsageError(f"{folder / DESIGN}: {mistakes[0]}{more}")
    return design


def check(folder: Path) -> tuple[Design, list[Mistake]]:
    """Return the design in a folder, and all mistakes, by line. With mistakes it is of no use.

    UsageError: there is no such file.
    """
    if not (folder / DESIGN).exists():
        raise UsageError(f"{folder} has no {DESIGN}; make it: `cushion study new {folder}`")
    content = text_of(folder / DESIGN)
    document, mistakes = parse(content)
    lines = lines_of_keys(content)
    made: dict[str, list[Any]] = {name: [] for name in TABLES}
    found: list[tuple[str, Any, Refusal]] = []
    for name, kind in TABLES.items():
        rows = document.pop(name, [])
        if not isinstance(rows, list) or not rows or not all(isinstance(r, dict) for r in rows):
            allowed = f"one or more [[{name}]]"
            found.append((name, None, Refusal("is missing, so there are zero trials", allowed)))
            continue
        for number, row in enumerate(rows, 1):
            made[name].append(_read(kind, row, folder, f"{name}[{number}].", found))
    study = _read(Study, document, folder, "", found)
    refused = {key for key, _, _ in found}
    by_name = {name: {one.name: one for one in ones} for name, ones in made.items()}
    digest = design_digest((folder / DESIGN).read_bytes())
    design = Design(folder, digest, study, *by_name.values())
    for name, ones in made.items():
        times = Counter(one.name for one in ones)
        for number, one in enumerate(ones, 1):
            prefix = f"{name}[{number}]."
            if one.name and times[one.name] > 1:
                wrong = f"is the name of {times[one.name]} [[{name}]]"
                why = Refusal(f"{wrong}: a duplicate", "names that differ")
                found.append((f"{prefix}name", one.name, why))
            for key, value, why in _CHECKS[name](one, design):
                if f"{prefix}{key}" not in refused:
                    found.append((f"{prefix}{key}", value, why))
    if (hours := design.hours) > HOURS_MAX:
        allowed = f"at most {HOURS_MAX:g} h; reduce repeats"
        why = Refusal(f"takes {hours:.1f} h for each participant", allowed)
        found.append(("this study", None, why))
    for key, value, why in found:
        shown = list(value) if isinstance(value, tuple) else value
        shown = "" if value is None or isinstance(value, dict) else printable(str(shown))
        line = next((lines[one] for one in (key, key.rpartition(".")[0]) if one in lines), 0)
        told = why.wrong, why.allowed, why.nearest
        mistakes.append(Mistake(printable(key), line, shown, *told))
    return design, sorted(mistakes, key=lambda mistake: mistake.line)


def _read(
    kind: type[Described], row: Mapping[str, Any], folder: Path, prefix: str, found: list[Any]
) -> Any:
    """Return an object with the accepted values, not validated; append the others to `found`."""
    known = kind.DESCRIPTIONS
    for key in row.keys() - known.keys():
        why = Refusal("is an unknown key", ", ".join(known), nearest(key, known))
        found.append((f"{prefix}{key}", None, why))
    values = {key: known[key].resolved(row[key], folder) for key in row if key in known}
    refusals = kind.refusals(values)
    found += [(f"{prefix}{key}", row.get(key), why) for key, why in refusals.items()]
    accepted = {key: known[key].typed(values[key]) for key in values if key not in refusals}
    one = object.__new__(kind)
    vars(one).update({key: NEUTRAL.get(key, "") for key in refusals} | kind.defaults() | accepted)
    return one


def _of_stimulus(one: Stimulus, design: Design) -> Found:
    if str(one.file) and not 0.1 <= (seconds := one.duration_s) <= 600.0:
        wrong = f"lasts {seconds:.3g} s" if seconds else "is not a sound file"
        yield "file", one.file, Refusal(wrong, "a sound of 0.1 to 600 s that libsndfile reads")


def _of_condition(one: Condition, design: Design) -> Found:
    if one.method in METHODS or not one.method:
        return
    if "." not in one.method and "/" not in one.method:
        allowed = f"{', '.join(METHODS)}, or a file, such as {{stimulus}}.wav"
        yield "method", one.method, Refusal("is not known", allowed, nearest(one.method, METHODS))
        return
    for path in {design.vibration_file(one, name): 0 for name in design.stimuli}:
        if path and not path.is_file():
            yield "method", one.method, Refusal(f"needs {path}, which is no file", "existing files")


def _of_question(one: Question, design: Design) -> Found:
    least = NEEDS.get(one.paradigm, (1, 1))
    tables = ("conditions", design.conditions, least[0]), ("stimuli", design.stimuli, least[1])
    for key, known, needed in tables:
        names = getattr(one, key)
        for name, count in Counter(names).items():
            if name not in known:
                wrong = f"has {name!r}, which the design does not describe"
                yield key, names, Refusal(wrong, ", ".join(known), nearest(name, known))
            if count > 1:
                wrong = f"has the duplicate {name!r}"
                yield key, names, Refusal(wrong, "each name once")
        if len(names) < needed:
            yield (
                key,
                names,
                Refusal(
                    f"has {len(names)} names",
                    f"{needed} or more for {one.paradigm or 'a question'}",
                ),
            )
    for key in HIDDEN.get(one.paradigm, ()):
        if (name := getattr(one, key)) not in one.conditions:
            wrong = "is not among the conditions" if name else "is missing"
            yield key, name or None, Refusal(wrong, ", ".join(one.conditions))
    if one.paradigm not in ("rating", "identification") and one.repeats % 2:
        why = Refusal("is odd, so order and side cannot be balanced", "even numbers")
        yield "repeats", one.repeats, why


_CHECKS: dict[str, Any] = {
    "stimulus": _of_stimulus,
    "condition": _of_condition,
    "question": _of_question,
}

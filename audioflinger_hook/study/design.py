"""The design of a study, `design.toml`: reads it, and finds all mistakes in it at once."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import soundfile

from audioflinger_hook.baselines import BASELINES
from audioflinger_hook.config.kinds import FileName, Names
from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.config.toml_text import Mistake, lines_of_keys, parse, printable, text_of
from audioflinger_hook.trials.record import design_digest
from device.errors import UsageError
from device.values import Choice, Described, Description, Number, Refusal, Switch, Text, nearest

DESIGN, HOURS_MAX = "design.toml", 8.0
NONE = "none"
METHODS = (NONE, *BASELINES, *PROFILES)
NEEDS = {"preference": 2, "rating": 3, "equal": 2}  # least number of conditions; of others: 1
PARADIGMS = ("preference", "rating", "synchrony", "threshold", "equal", "identification")
ADAPTIVE = ("threshold", "equal")
OFFSETS_MS = (-200.0, -120.0, -80.0, -40.0, -20.0, 0.0, 20.0, 40.0, 80.0, 120.0, 200.0)
GAP_S = 0.4  # silence between the two intervals of a trial


@dataclass(frozen=True)
class _Offsets(Description):
    @property
    def allowed(self) -> str:
        return "a list of 3 or more different numbers from -500 to 500 ms"

    def refuse(self, value: object) -> Refusal | None:
        numbers, one = value if isinstance(value, (list, tuple)) else [], Number("", -500, 500)
        good = len(set(map(str, numbers))) == len(numbers) >= 3 and not any(map(one.refuse, numbers))
        return None if good else Refusal("is not such a list", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        return {"type": "array", "items": {"type": "number"}, "minItems": 3}


@dataclass(frozen=True)
class _Effect(Description):
    allowed = "a table, such as {worth = {cinema = 1.0}}; see docs/study.md"

    def refuse(self, value: object) -> Refusal | None:
        return None if isinstance(value, dict) else Refusal("is not a table", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        return {"type": "object"}


@dataclass(frozen=True)
class Stimulus(Described):
    """A sound of the study."""

    name: Annotated[str, Text("name in questions")]
    file: Annotated[Path, FileName("the sound", grammar="the path of a sound file")]


@dataclass(frozen=True)
class Condition(Described):
    """A way to compute vibration from a sound."""

    name: Annotated[str, Text("name in questions")]
    method: Annotated[str, Text("baseline, profile, or file of the vibration")]
    delay_ms: Annotated[float, Number("delay of the vibration", -500, 500, "ms")] = 0.0
    gain_db: Annotated[float, Number("strength against the other conditions", -60, 12, "dB")] = 0.0


@dataclass(frozen=True)
class Question(Described):
    """A question to the participants, with its conditions and sounds."""

    name: Annotated[str, Text("name in the record")]
    paradigm: Annotated[str, Choice("kind of the trials", PARADIGMS)]
    conditions: Annotated[Sequence[str], Names("names of the conditions")]
    stimuli: Annotated[Sequence[str], Names("names of the sounds")]
    repeats: Annotated[int, Number("trials of each kind", 1, 1000, whole=True)]
    ask: Annotated[str, Text("text of the question; by default the paradigm's")] = ""
    reference: Annotated[str, Text("the reference's condition")] = ""
    anchor: Annotated[str, Text("the hidden anchor's condition")] = ""
    judgement: Annotated[
        str, Choice("what is asked about synchrony", ("simultaneity", "order"))
    ] = "simultaneity"
    offsets_ms: Annotated[Sequence[float], _Offsets("vibration after the sound")] = OFFSETS_MS
    lowest_db: Annotated[float, Number("weakest level of adaptive trials", -80, -5, "dB")] = -40.0
    highest_db: Annotated[float, Number("strongest level of adaptive trials", 0, 20, "dB")] = 0.0
    sound: Annotated[bool, Switch("whether the sound is heard")] = True
    exploratory: Annotated[bool, Switch("whether the question is not preregistered")] = False
    effect: Annotated[Mapping[str, Any], _Effect("true parameters for the power")] = None  # type: ignore[assignment]

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """The conditions of the two intervals of each kind of trial; "" for one interval."""
        if self.paradigm == "preference":
            return list(combinations(self.conditions, 2))
        first = {"rating": self.reference, "threshold": NONE, "equal": self.reference}
        if (other := first.get(self.paradigm, "")) and self.paradigm != "rating":
            return [(one, other) for one in self.conditions if one != other]
        return [(other, one) if other else (one, "") for one in self.conditions]

    @property
    def trials(self) -> int:
        """Number of trials of one participant, without practice."""
        delays = len(self.offsets_ms) if self.paradigm == "synchrony" else 1
        return len(self.pairs) * len(self.stimuli) * self.repeats * delays


@dataclass(frozen=True)
class Study(Described):
    """What holds for the whole study."""

    title: Annotated[str, Text("title")]
    participants: Annotated[int, Number("participants after whom it ends", 2, 10_000, whole=True)]
    seed: Annotated[int, Number("seed of all random orders", 0, 2**31, whole=True)] = 1
    consent: Annotated[str, Text("text that participants agree to")] = "I take part voluntarily."
    level_db: Annotated[
        float, Number("level, relative to a full-scale sine of 80 Hz", -60, 0, "dB")
    ] = -25.0
    masking_db: Annotated[
        float | None, Number("pink noise over the sound", -80, -10, "dBFS", word="off")
    ] = None
    practice: Annotated[int, Number("practice trials of a question", 0, 100, whole=True)] = 2
    block: Annotated[int, Number("trials between two pauses", 1, 1000, whole=True)] = 20
    answer_s: Annotated[float, Number("expected time of an answer", 0.1, 60, "s")] = 2.5
    power: Annotated[float, Number("wanted power", 0.5, 0.99)] = 0.8
    fastest_s: Annotated[
        float, Number("exclude participants with a faster median answer", 0, 5, "s")
    ] = 0.2
    reference_below: Annotated[float, Number("exclude who rate the reference lower", 0, 100)] = 90.0
    reference_share: Annotated[float, Number("in more than this share of trials", 0, 1)] = 0.15


@dataclass(frozen=True)
class Design:
    """A study without mistakes. digest: SHA-256 of the bytes of `design.toml`."""

    folder: Path
    digest: str
    study: Study
    stimuli: Mapping[str, Stimulus]
    conditions: Mapping[str, Condition]
    questions: Mapping[str, Question]

    @cached_property
    def files(self) -> list[Path]:
        """All files of sound and vibration that the design names."""
        named = {one.file for one in self.stimuli.values()}
        return sorted(named | {path for _, path in _vibration_files(self)})

    @property
    def hours(self) -> float:
        """Expected duration of one participant's session."""
        total_s = 0.0
        for question in self.questions.values():
            infos = [soundfile.info(self.stimuli[name].file) for name in question.stimuli]
            one_s = sum(info.duration for info in infos) / len(infos)
            trial_s = sum((one_s + GAP_S) for one in question.pairs[0] if one)
            trial_s += GAP_S + self.study.answer_s
            total_s += (question.trials + self.study.practice) * trial_s
        return total_s / 3600.0

    def vibration_file(self, condition: Condition, stimulus: str) -> Path | None:
        """Return the file that a condition names for a sound, None for a computed vibration."""
        if condition.method in METHODS:
            return None
        return self.folder / condition.method.replace("{stimulus}", stimulus)


TABLES: dict[str, type[Described]] = {
    "stimulus": Stimulus,
    "condition": Condition,
    "question": Question,
}


def load(folder: Path) -> Design:
    """Return the design in a folder. UsageError: it has mistakes; see `check`."""
    design, mistakes = check(folder)
    if design is None:
        more = f" (and {len(mistakes) - 1} more; see `cushion study check`)" if mistakes[1:] else ""
        raise UsageError(f"{folder / DESIGN}: {mistakes[0]}{more}")
    return design


def check(folder: Path) -> tuple[Design | None, list[Mistake]]:
    """Return the design in a folder, or None and all mistakes. UsageError: no such file."""
    path = folder / DESIGN
    text = text_of(path)
    document, mistakes = parse(text)
    lines = lines_of_keys(text)

    def add(key: str, value: object, refusal: Refusal) -> None:
        shown = "" if value is None or isinstance(value, dict) else printable(str(value))
        name = next((part for part in (key, key.rpartition(".")[0]) if part in lines), "")
        why = refusal.wrong, refusal.allowed, refusal.nearest
        mistakes.append(Mistake(printable(key), lines.get(name, 0), shown, *why))

    tables: dict[str, list[dict[str, Any]]] = {}
    for name in TABLES:
        found = document.pop(name, [])
        good = isinstance(found, list) and all(isinstance(one, dict) for one in found)
        tables[name] = found if good else []
        if not good or not found:
            add(name, None, Refusal("is missing: there are no trials", f"one or more [[{name}]]"))
    read: dict[str, list[Any]] = {name: [] for name in TABLES}
    study: Study | None = None
    rows = [("", document, Study)]
    for name, kind in TABLES.items():
        rows += [(f"{name}[{i}].", row, kind) for i, row in enumerate(tables[name], 1)]  # type: ignore[misc]
    for prefix, row, kind in rows:
        known, before = kind.DESCRIPTIONS, len(mistakes)
        values = {key: known[key].resolved(v, folder) for key, v in row.items() if key in known}
        for key in row.keys() - known.keys():
            allowed = ", ".join(known)
            add(f"{prefix}{key}", None, Refusal("is an unknown key", allowed, nearest(key, known)))
        for key, refusal in kind.refusals(values).items():
            add(f"{prefix}{key}", row.get(key), refusal)
        if len(mistakes) == before:
            made = kind(**{key: known[key].typed(value) for key, value in values.items()})
            if isinstance(made, Study):
                study = made
            else:
                read[prefix.partition("[")[0]].append((prefix, made))
        elif prefix and isinstance(row.get("name"), str):
            read[prefix.partition("[")[0]].append((prefix, row["name"]))
    everything = {
        name: {getattr(one, "name", one): one for _, one in found} for name, found in read.items()
    }
    for name, found in read.items():
        times = Counter(getattr(one, "name", one) for _, one in found)
        seen: set[str] = set()
        for prefix, one in found:
            called = getattr(one, "name", one)
            if called in seen:
                why = f"is the name of {times[called]} {name}s"
                add(f"{prefix}name", called, Refusal(why, "a name that no other has"))
            seen.add(called)
    for prefix, one in [*read["stimulus"], *read["condition"], *read["question"]]:
        for key, refusal in _contradictions(one, folder, everything):
            add(f"{prefix}{key}", getattr(one, key), refusal)
    if mistakes or study is None:
        return None, sorted(mistakes, key=lambda mistake: mistake.line)
    design = Design(folder, design_digest(path.read_bytes()), study, *everything.values())
    if design.hours > HOURS_MAX:
        takes = f"takes {design.hours:.1f} h for each participant"
        add("this study", None, Refusal(takes, f"at most {HOURS_MAX:g} h; reduce repeats"))
        return None, mistakes
    return design, []


def _vibration_files(design: Design) -> Iterator[tuple[str, Path]]:
    for condition in design.conditions.values():
        for stimulus in design.stimuli:
            if path := design.vibration_file(condition, stimulus):
                yield condition.name, path


def _contradictions(
    one: Any, folder: Path, everything: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, Refusal]]:
    """Yield each mistake that only other tables, or the files, show: its key, and why."""
    if isinstance(one, Stimulus):
        try:
            info = soundfile.info(one.file)
            if not 0.1 <= info.duration <= 600.0:
                yield "file", Refusal(f"lasts {info.duration:.3g} s", "0.1 to 600 s")
        except (OSError, soundfile.LibsndfileError):
            yield "file", Refusal("is not a sound file", "a format that libsndfile reads")
    if isinstance(one, Condition) and one.method not in METHODS:
        if "." not in one.method and "/" not in one.method:
            allowed = f"{', '.join(METHODS)}, or a file, such as {{stimulus}}.wav"
            yield "method", Refusal("is not known", allowed, nearest(one.method, METHODS))
            return
        for name in everything["stimulus"]:
            path = folder / one.method.replace("{stimulus}", name)
            if not path.is_file():
                yield "method", Refusal(f"needs {path}, which is not a file", "files that exist")
    if isinstance(one, Question):
        yield from _of_question(one, everything)


def _of_question(
    one: Question, everything: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, Refusal]]:
    for key, table in (("conditions", "condition"), ("stimuli", "stimulus")):
        names, known = getattr(one, key), everything[table]
        least = NEEDS.get(one.paradigm, 1) if table == "condition" else 1
        least = 2 if (table, one.paradigm) == ("stimulus", "identification") else least
        for name in [name for name in names if name not in known]:
            unknown = f"has {name!r}, which is no [[{table}]]"
            yield key, Refusal(unknown, ", ".join(known), nearest(name, known))
        for name in [name for name, count in Counter(names).items() if count > 1]:
            yield key, Refusal(f"has {name!r} {names.count(name)} times", "each name once")
        if len(names) < least:
            few = f"has {len(names)}" if names else "is empty: there are zero trials"
            yield key, Refusal(few, f"{least} or more for {one.paradigm}")
    for key in {"rating": ("reference", "anchor"), "equal": ("reference",)}.get(one.paradigm, ()):
        if (name := getattr(one, key)) not in one.conditions:
            wrong = "is not among the conditions" if name else "is missing"
            yield key, Refusal(wrong, ", ".join(one.conditions))
    if one.paradigm not in ("rating", "identification") and one.repeats % 2:
        yield "repeats", Refusal("is odd, so order and side cannot be balanced", "even numbers")

"""The design of a study: reads `design.toml`, and finds all mistakes in it at once."""

import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
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
from device.values import Choice, Described, Number, Refusal, Switch, Text, nearest

DESIGN, HOURS_MAX, SOUND_S = "design.toml", 8.0, (0.1, 100.0)
NONE = "none"
METHODS = (NONE, *BASELINES, *PROFILES)
BUILT_IN = files("audioflinger_hook.study") / "built_in"
TABLE = tomllib.loads((BUILT_IN / "paradigms.toml").read_text())
PARADIGMS = ("preference", "rating", "synchrony", "threshold", "equal", "identification")
OFFSETS_MS = (-200.0, -120.0, -80.0, -40.0, -20.0, 0.0, 20.0, 40.0, 80.0, 120.0, 200.0)
GAP_S = 0.4  # silence between the two intervals of a trial
NEUTRAL = {"conditions": (), "stimuli": (), "repeats": 0}  # in place of refused values; else ""


@dataclass(frozen=True)
class _Free(Text):
    is_good: Callable[[Any], bool] = bool

    def refuse(self, value: object) -> Refusal | None:
        return None if self.is_good(value) else Refusal("is not that", self.allowed)


def _are_offsets(value: Any) -> bool:
    different = isinstance(value, list) and len(set(map(str, value))) == len(value) >= 3
    return different and not any(map(Number("", -500.0, 500.0).refuse, value))


OFFSETS = _Free("delays", "3 or more different numbers, -500 to 500", is_good=_are_offsets)
EFFECT = _Free("of the power", "{worth = {NAME = 1}}", is_good=lambda one: isinstance(one, dict))


@dataclass(frozen=True)
class Stimulus(Described):
    """A sound of the study."""

    name: Annotated[str, Text("name in questions")]
    file: Annotated[Path, FileName("the sound", grammar="the path of a sound file")]

    @property
    def duration_s(self) -> float:
        """Duration in s; 0 if the file cannot be read."""
        try:
            return float(soundfile.info(self.file).duration)
        except (OSError, TypeError, soundfile.LibsndfileError):
            return 0.0


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
    judgement: Annotated[str, Choice("what is asked", ("simultaneity", "order"))] = "simultaneity"
    offsets_ms: Annotated[Sequence[float], OFFSETS] = OFFSETS_MS
    lowest_db: Annotated[float, Number("weakest level of adaptive trials", -80, -5, "dB")] = -40.0
    highest_db: Annotated[float, Number("strongest level of adaptive trials", 0, 20, "dB")] = 0.0
    sound: Annotated[bool, Switch("whether the sound is heard")] = True
    exploratory: Annotated[bool, Switch("whether the question is not preregistered")] = False
    effect: Annotated[Mapping[str, Any] | None, EFFECT] = None

    @property
    def kind(self) -> Mapping[str, Any]:
        """The paradigm's row of `paradigms.toml`; of an unknown paradigm, that of synchrony."""
        row: Mapping[str, Any] = TABLE.get(self.paradigm) or TABLE[self.judgement]
        return row

    @property
    def is_adaptive(self) -> bool:
        """Whether levels depend on the answers before."""
        return self.paradigm in ("threshold", "equal")

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """The conditions of the two intervals of each kind of trial; "" for one interval."""
        if self.paradigm == "preference":
            return list(combinations(self.conditions, 2))
        if self.paradigm == "rating":
            return [(self.reference, one) for one in self.conditions]
        other = {"threshold": NONE, "equal": self.reference}.get(self.paradigm, "")
        return [(one, other) for one in self.conditions if one != other]

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
    level_db: Annotated[float, Number("level of all vibrations", -60, 0, "dB")] = -25.0
    masking_db: Annotated[float | None, Number("noise", -80, -10, "dBFS", word="off")] = None
    practice: Annotated[int, Number("practice trials of a question", 0, 100, whole=True)] = 2
    block: Annotated[int, Number("trials between two pauses", 1, 1000, whole=True)] = 20
    answer_s: Annotated[float, Number("expected time of an answer", 0.1, 60, "s")] = 2.5
    power: Annotated[float, Number("wanted power", 0.5, 0.99)] = 0.8
    fastest_s: Annotated[float, Number("exclude with a faster median answer", 0, 5, "s")] = 0.2
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

    @property
    def files(self) -> list[Path]:
        """All files of sound and vibration that the design names."""
        named = [self.vibration_file(c, s) for c in self.conditions.values() for s in self.stimuli]
        return sorted({path for path in named if path} | {s.file for s in self.stimuli.values()})

    @property
    def hours(self) -> float:
        """Expected duration of one participant's session; unreadable sounds count as 0 s."""
        total_s = 0.0
        for question in self.questions.values():
            sounds_s = [
                self.stimuli[one].duration_s for one in question.stimuli if one in self.stimuli
            ]
            intervals = sum(map(bool, question.pairs[0])) if question.pairs else 0
            played_s = intervals * (sum(sounds_s) / max(1, len(sounds_s)) + GAP_S)
            trials = question.trials + self.study.practice
            total_s += trials * (played_s + GAP_S + self.study.answer_s)
        return total_s / 3600.0

    def vibration_file(self, condition: Condition, stimulus: str) -> Path | None:
        """Return the file that a condition names for a sound, None for a computed vibration."""
        if condition.method in METHODS:
            return None
        return self.folder / condition.method.replace("{stimulus}", stimulus)


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
    (document, mistakes), lines, refused = parse(content), lines_of_keys(content), set[str]()

    def tell(key: str, value: Any, why: Refusal) -> None:
        shown = list(value) if isinstance(value, tuple) else value
        shown = "" if value is None or isinstance(value, dict) else printable(str(shown))
        line = lines.get(key) or lines.get(key.rpartition(".")[0]) or 0
        mistakes.append(Mistake(printable(key), line, shown, why.wrong, why.allowed, why.nearest))

    def read(kind: type[Described], row: Mapping[str, Any], prefix: str) -> Any:
        known = kind.DESCRIPTIONS
        for key in row.keys() - known.keys():
            allowed = ", ".join(known)
            tell(prefix + key, None, Refusal("is an unknown key", allowed, nearest(key, known)))
        values = {key: known[key].resolved(row[key], folder) for key in row if key in known}
        refusals = kind.refusals(values)
        for key, why in refusals.items():
            tell(prefix + key, row.get(key), why)
            refused.add(prefix + key)
        accepted = {key: known[key].typed(values[key]) for key in values if key not in refusals}
        one = object.__new__(kind)  # not validated, to find the other mistakes as well
        vars(one).update(dict.fromkeys(refusals, "") | NEUTRAL | kind.defaults() | accepted)
        return one

    tables: dict[str, list[Any]] = {}
    for name, kind in (("stimulus", Stimulus), ("condition", Condition), ("question", Question)):
        rows = document.pop(name, [])
        if not isinstance(rows, list) or not rows or not all(isinstance(r, dict) for r in rows):
            allowed, rows = f"one or more [[{name}]]", []
            tell(name, None, Refusal("is missing, so there are zero trials", allowed))
        tables[name] = [read(kind, row, f"{name}[{n}].") for n, row in enumerate(rows, 1)]
    study = read(Study, document, "")
    by_name = [{one.name: one for one in ones} for ones in tables.values()]
    design = Design(folder, design_digest((folder / DESIGN).read_bytes()), study, *by_name)
    for name, ones in tables.items():
        times = Counter(one.name for one in ones)
        for number, one in enumerate(ones, 1):
            found = list(_contradictions(one, design))
            if one.name and times[one.name] > 1:
                wrong = f"is the name of {times[one.name]} [[{name}]]: a duplicate"
                found.append(("name", Refusal(wrong, "names that differ")))
            for key, why in found:
                if (full := f"{name}[{number}].{key}") not in refused:
                    tell(full, getattr(one, key) or None, why)
    if (hours := design.hours) > HOURS_MAX:
        why = Refusal(f"takes {hours:.1f} h for each participant", f"at most {HOURS_MAX:g} h")
        tell("this study", None, why)
    return design, sorted(mistakes, key=lambda mistake: mistake.line)


def _contradictions(one: Any, design: Design) -> Iterator[tuple[str, Refusal]]:
    """Yield the keys that are wrong beside other values, and why."""
    if isinstance(one, Stimulus):
        if str(one.file) and not SOUND_S[0] <= (seconds := one.duration_s) <= SOUND_S[1]:
            wrong = f"lasts {seconds:.3g} s" if seconds else "is not a sound file"
            allowed = "a sound of {:g} to {:g} s that libsndfile reads".format(*SOUND_S)
            yield "file", Refusal(wrong, allowed)
    elif isinstance(one, Condition):
        if one.method and one.method not in METHODS and not {".", "/"} & {*one.method}:
            allowed = f"{', '.join(METHODS)}, or a file, such as {{stimulus}}.wav"
            yield "method", Refusal("is not known", allowed, nearest(one.method, METHODS))
            return
        for path in {design.vibration_file(one, name): 0 for name in design.stimuli}:
            if one.method and path and not path.is_file():
                yield "method", Refusal(f"needs {path}, which is no file", "existing files")
    else:
        for key, known in (("conditions", design.conditions), ("stimuli", design.stimuli)):
            names, least = getattr(one, key), one.kind[key]
            for name, count in Counter(names).items():
                if name not in known:
                    wrong = f"has {name!r}, which the design does not describe"
                    yield key, Refusal(wrong, ", ".join(known), nearest(name, known))
                if count > 1:
                    yield key, Refusal(f"has the duplicate {name!r}", "each name once")
            if len(names) < least:
                allowed = f"{least} or more for {one.paradigm or 'a question'}"
                yield key, Refusal(f"has {len(names)} names", allowed)
        for key in one.kind["hidden"]:
            if (name := getattr(one, key)) not in one.conditions:
                wrong = "is not among the conditions" if name else "is missing"
                yield key, Refusal(wrong, ", ".join(one.conditions))
        if one.kind["is_balanced"] and one.repeats % 2:
            wrong = "is odd, so order and side cannot be balanced"
            yield "repeats", Refusal(wrong, "even numbers")

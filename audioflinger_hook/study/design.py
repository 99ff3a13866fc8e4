"""The design of a study, as `design.toml` describes it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import soundfile

from audioflinger_hook.baselines import BASELINES
from audioflinger_hook.config.kinds import FileName, Names
from audioflinger_hook.config.profiles import PROFILES
from device.values import Choice, Described, Description, Number, Refusal, Switch, Text

DESIGN, HOURS_MAX = "design.toml", 8.0
NONE = "none"
METHODS = (NONE, *BASELINES, *PROFILES)
PARADIGMS = ("preference", "rating", "synchrony", "threshold", "equal", "identification")
ADAPTIVE = ("threshold", "equal")
OFFSETS_MS = (-200.0, -120.0, -80.0, -40.0, -20.0, 0.0, 20.0, 40.0, 80.0, 120.0, 200.0)
GAP_S = 0.4  # silence between the two intervals of a trial


@dataclass(frozen=True)
class _Free(Description):
    """A list or table that `is_good` accepts."""

    is_good: Callable[[Any], bool]
    grammar: str

    @property
    def allowed(self) -> str:
        return self.grammar

    def refuse(self, value: object) -> Refusal | None:
        return None if self.is_good(value) else Refusal("is not that", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        return {}


def _are_offsets(value: Any) -> bool:
    is_number = Number("", -500.0, 500.0).refuse
    return (
        isinstance(value, list)
        and len(set(map(str, value))) == len(value) >= 3
        and not any(map(is_number, value))
    )


OFFSETS = _Free("delays of the vibration", _are_offsets, "3 or more different numbers, -500 to 500")
EFFECT = _Free(
    "true parameters for the power", lambda value: isinstance(value, dict), "{worth = {NAME = 1}}"
)


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
    judgement: Annotated[
        str, Choice("what is asked about synchrony", ("simultaneity", "order"))
    ] = "simultaneity"
    offsets_ms: Annotated[Sequence[float], OFFSETS] = OFFSETS_MS
    lowest_db: Annotated[float, Number("weakest level of adaptive trials", -80, -5, "dB")] = -40.0
    highest_db: Annotated[float, Number("strongest level of adaptive trials", 0, 20, "dB")] = 0.0
    sound: Annotated[bool, Switch("whether the sound is heard")] = True
    exploratory: Annotated[bool, Switch("whether the question is not preregistered")] = False
    effect: Annotated[Mapping[str, Any] | None, EFFECT] = None

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

    @property
    def files(self) -> list[Path]:
        """All files of sound and vibration that the design names."""
        named = [self.vibration_file(c, s) for c in self.conditions.values() for s in self.stimuli]
        sounds = [one.file for one in self.stimuli.values()]
        return sorted({path for path in (*named, *sounds) if path})

    @property
    def hours(self) -> float:
        """Expected duration of one participant's session; unreadable sounds count as 0 s."""
        total_s = 0.0
        for question in self.questions.values():
            trial_s = GAP_S + self.study.answer_s
            for one in question.stimuli:
                if one in self.stimuli and question.pairs:
                    intervals = sum(bool(name) for name in question.pairs[0])
                    sound_s = self.stimuli[one].duration_s
                    trial_s += intervals * (sound_s + GAP_S) / len(question.stimuli)
            total_s += (question.trials + self.study.practice) * trial_s
        return total_s / 3600.0

    def vibration_file(self, condition: Condition, stimulus: str) -> Path | None:
        """Return the file that a condition names for a sound, None for a computed vibration."""
        if condition.method in METHODS:
            return None
        return self.folder / condition.method.replace("{stimulus}", stimulus)

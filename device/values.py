"""Allowed values of dataclass fields: each field has a description, which checks its values.

    @dataclass(frozen=True)
    class Gate(Described):
        floor_db: Annotated[float, Number("level of a shut gate", -90, -30, "dB")] = -60.0

`Gate(floor_db=0)` raises a UsageError that names every invalid field. `Gate.refusals(values)`
returns the errors as a dict. Pure functions; any thread may call them.
"""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, MISSING, dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, get_origin, get_type_hints

from device.errors import UsageError

OFF = "off"


def no_such(kind: str, name: str, names: Iterable[str], where_none: str) -> str:
    """Return a one-line message that a name is unknown, with similar or existing names.

    kind: kind of the named object, such as "sink". names: names of the existing objects.
    where_none: advice if no object of this kind exists.
    """
    known = sorted(names)
    if similar := get_close_matches(name, known, n=3, cutoff=0.5):
        offer = f"did you mean {' or '.join(map(repr, similar))}?"
    elif known:
        offer = f"there are {', '.join(repr(one) for one in known[:8])}"
        offer += " and others" if len(known) > 8 else ""
    else:
        offer = f"none was found; {where_none}"
    return f"no {kind} {name!r}; {offer}"


def counted(count: int, things: str) -> str:
    """Return a count with its noun: "1 buffer", "2 buffers"."""
    one = f"{things[:-3]}y" if things.endswith("ies") else things.removesuffix("s")
    return f"{count} {one if count == 1 else things}"


def nearest(name: str, names: Iterable[str]) -> str:
    """Return the known name that is most similar to `name`, "" if none is similar."""
    return next(iter(get_close_matches(name, list(names), n=1)), "")


@dataclass(frozen=True)
class Refusal:
    """Why a value is refused, the allowed values, and the most similar allowed name."""

    wrong: str
    allowed: str
    nearest: str = ""

    def __str__(self) -> str:
        guess = f"; did you mean {self.nearest}?" if self.nearest else ""
        return f"{self.wrong}; allowed: {self.allowed}{guess}"


@dataclass(frozen=True)
class Description(ABC):
    """Meaning and allowed values of one field.

    meaning: the purpose of the field, in a few words. name: the field's name for users, if
    different. section: the field's section in a config file, if not the section of its class.
    change: the effect of a new value while the program runs, if not the default of the class.
    """

    meaning: str
    _: KW_ONLY
    name: str = ""
    section: str = ""
    change: str = ""

    @property
    @abstractmethod
    def allowed(self) -> str:
        """The allowed values in words."""

    @abstractmethod
    def refuse(self, value: object) -> Refusal | None:
        """Return why the value is refused, None if it is accepted. value: of any type."""

    @abstractmethod
    def json_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the accepted values."""

    def resolved(self, value: object, folder: Path) -> object:
        """Return the value; a relative path in it is resolved against `folder`."""
        return value

    def typed(self, value: Any) -> Any:
        """Return an accepted value converted to the field's type."""
        return value


@dataclass(frozen=True)
class Number(Description):
    """A number from low to high, both included. word: is allowed instead; "off" means None."""

    low: float
    high: float
    unit: str = ""
    whole: bool = False
    word: str = ""

    @property
    def allowed(self) -> str:
        """The range with its unit."""
        word = f", or {self.word}" if self.word else ""
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip() + word

    def refuse(self, value: object) -> Refusal | None:
        """Refuse NaN, numbers outside the range, booleans and other types."""
        if self._is_word(value):
            return None
        if isinstance(value, bool) or not isinstance(value, int if self.whole else (int, float)):
            return Refusal(f"is not a {'whole ' * self.whole}number", self.allowed)
        return None if self.low <= value <= self.high else Refusal("is out of range", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        """Return the schema of a number in the range, without the word."""
        kind = "integer" if self.whole else "number"
        return {"type": kind, "minimum": self.low, "maximum": self.high}

    def typed(self, value: Any) -> Any:
        """Return the number as a float or an int, None for "off", and any other word as it is."""
        if self._is_word(value):
            return None if value == OFF else value
        return value if self.whole else float(value)

    def _is_word(self, value: object) -> bool:
        return isinstance(value, str) and value == self.word != ""


@dataclass(frozen=True)
class Choice(Description):
    """One of several words or whole numbers. `aliases` are accepted but not named in messages."""

    words: tuple[str, ...] | tuple[int, ...]
    unit: str = ""
    aliases: tuple[str, ...] = ()

    @property
    def allowed(self) -> str:
        """All words except the aliases, and the unit."""
        return f"{', '.join(map(str, self.words))} {self.unit}".rstrip()

    def refuse(self, value: object) -> Refusal | None:
        """Refuse unknown words and values of another type."""
        if type(value) is type(self.words[0]) and value in (*self.words, *self.aliases):
            return None
        guess = nearest(value, map(str, self.words)) if isinstance(value, str) else ""
        return Refusal("is not known", self.allowed, guess)

    def json_schema(self) -> dict[str, Any]:
        """Return an enumeration."""
        return {"enum": [*self.words, *self.aliases]}


@dataclass(frozen=True)
class Switch(Description):
    """True or false."""

    @property
    def allowed(self) -> str:
        """The two boolean words of TOML."""
        return "true, false"

    def refuse(self, value: object) -> Refusal | None:
        """Refuse everything except True and False; 0 and 1 are refused."""
        return None if isinstance(value, bool) else Refusal("is not true or false", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        """Return a boolean."""
        return {"type": "boolean"}


@dataclass(frozen=True)
class Text(Description):
    """A text of at least so many characters. `grammar` describes its form in words."""

    grammar: str = "a text that is not empty"
    least: int = field(default=1, kw_only=True)

    @property
    def allowed(self) -> str:
        """The grammar."""
        return self.grammar

    def refuse(self, value: object) -> Refusal | None:
        """Refuse a shorter text and every other type."""
        is_good = isinstance(value, str) and len(value) >= self.least
        return None if is_good else Refusal("is not a text", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        """Return a string."""
        return {"type": "string", "minLength": self.least}


class Described:
    """Base class of dataclasses whose fields have descriptions: `Annotated[type, Number(...)]`.

    The descriptions are appended to the class's docstring. UsageError: the constructor received
    invalid values; the message names all of them.
    """

    DESCRIPTIONS: ClassVar[Mapping[str, Description]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        hints = get_type_hints(cls, include_extras=True)
        hints = {name: hint for name, hint in hints.items() if get_origin(hint) is Annotated}
        cls.DESCRIPTIONS = {name: hint.__metadata__[0] for name, hint in hints.items()}
        text = inspect.cleandoc(cls.__doc__ or "")
        text += "" if "\nAttributes\n---" in text else "\n\nAttributes\n----------"
        for name, described in cls.DESCRIPTIONS.items():
            kind = hints[name].__origin__
            kind = kind.__name__ if isinstance(kind, type) else str(kind)
            kind = kind.replace("pathlib._local.", "pathlib.")  # Python 3.13 renames the module
            meaning = f"{described.meaning[0].upper()}{described.meaning[1:]}"
            text += f"\n{name} : {kind}\n    {meaning}. Allowed: {described.allowed}."
        cls.__doc__ = text

    def __post_init__(self) -> None:
        values = vars(self)
        found = []
        for name, refusal in self.refusals(values).items():
            described = self.DESCRIPTIONS.get(name)
            shown = f"{described.name or name}={_shown(values[name])}" if described else name
            found.append(f"{shown} {refusal}")
        if found:
            raise UsageError("; ".join(found))

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the defaults of all described fields that have a default."""
        return {name: getattr(cls, name) for name in cls.DESCRIPTIONS if hasattr(cls, name)}

    @classmethod
    def refusals(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return the error of each invalid field, by name; values may have any type.

        A field without a value has its default, which is accepted. Other names are not reported.
        """
        found: dict[str, Refusal] = {}
        accepted = {**values}
        for name, described in cls.DESCRIPTIONS.items():
            default = getattr(cls, name, MISSING)
            value = accepted[name] = values.get(name, default)
            if value is MISSING:
                refusal: Refusal | None = Refusal("is missing", described.allowed)
            else:
                refusal = None if value is default else described.refuse(value)
            if refusal:
                found[name] = refusal
                del accepted[name]
        return found | cls.contradictions(accepted)

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return an error for each value that contradicts another. values: each valid alone."""
        return {}

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """Return an instance. Values are converted by `typed`. UsageError: a value is invalid."""
        if found := cls.refusals(values):
            raise UsageError("; ".join(f"{name} {refusal}" for name, refusal in found.items()))
        known = cls.DESCRIPTIONS
        return cls(**{n: known[n].typed(v) if n in known else v for n, v in values.items()})


def _shown(value: object) -> str:
    if isinstance(value, tuple) and value:
        return ",".join(map(str, value))
    return f"{value:.12g}" if isinstance(value, float) else repr(value)

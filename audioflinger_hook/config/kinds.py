"""Kinds of values in a config: rigs, files, addresses and names. They check and convert values."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from audioflinger_hook.sources import parse_tap
from audioflinger_hook.transform.parameters import CURVE
from device.errors import UsageError
from device.rig.rig import SHIPPED, SUFFIX, read_rig
from device.values import Description, Refusal, Text


@dataclass(frozen=True)
class RigName(Text):
    """The name of a bundled rig, or the path of a valid rig file."""

    grammar: str = f"{', '.join(SHIPPED)}, or a file, NAME{SUFFIX}"

    def resolved(self, value: object, folder: Path) -> object:
        """Return the value; a relative path of a rig file is joined to `folder`."""
        is_file = isinstance(value, str) and value not in SHIPPED and value.endswith(SUFFIX)
        return str(folder / str(value)) if is_file else value

    def refuse(self, value: object) -> Refusal | None:
        """Return why the name is unknown or the rig file invalid; None if the value is allowed."""
        if not isinstance(value, str):
            return Refusal("is not a name", self.allowed)
        if value in SHIPPED:
            return None
        if not value.endswith(SUFFIX):
            return Refusal("is not known", self.allowed)
        try:
            read_rig(value)
        except (UsageError, ValueError) as error:  # ValueError: an invalid path
            return Refusal(f"cannot be used ({error})", self.allowed)
        return None


@dataclass(frozen=True)
class FileName(Text):
    """The path of a file. A path given as text must exist; a `Path` need not exist."""

    def resolved(self, value: object, folder: Path) -> object:
        """Return the value; a relative path is joined to `folder`."""
        return str(folder / value) if isinstance(value, str) and value else value

    def refuse(self, value: object) -> Refusal | None:
        """Return why the value is not the path of a file; None if it is allowed."""
        if isinstance(value, Path):
            return None
        if not isinstance(value, str) or not value:
            return Refusal("is not a path", self.allowed)
        good = "\0" not in value and Path(value).is_file()
        return None if good else Refusal("is not a file", self.allowed)

    def typed(self, value: Any) -> Any:
        """Return a path."""
        return Path(value)


def curve_text(curve_db: Mapping[str, float]) -> str:
    """Return a table of levels in dB, with Hz as keys, as a text that matches `CURVE`."""
    return ",".join(f"{hz}:{level_db}" for hz, level_db in curve_db.items())


@dataclass(frozen=True)
class Curve(Text):
    """A table of levels in dB, with frequencies in Hz as keys."""

    grammar: str = "levels under 100 dB by frequency in Hz"

    def refuse(self, value: object) -> Refusal | None:
        """Return why the value is not such a table; None if it is allowed."""
        is_good = isinstance(value, dict) and CURVE.fullmatch(curve_text(value))
        return None if is_good else Refusal("is not a table of frequencies", self.allowed)


@dataclass(frozen=True)
class Address(Text):
    """The address of a tap (source of sound) or a device, as users write it."""

    parse: Callable[[str], object] = str
    what: str = "address"

    def refuse(self, value: object) -> Refusal | None:
        """Return why `parse` refuses the address; None if it is allowed."""
        if not isinstance(value, str):
            return Refusal(f"is not a {self.what}", self.allowed)
        try:
            self.parse(value)
        except UsageError as error:
            reason = str(error.args[0]).removeprefix(f"{self.what} {value!r} ")
            return Refusal(reason.partition("; allowed: ")[0], self.allowed)
        return None


@dataclass(frozen=True)
class Taps(Address):
    """The address of one tap (source of sound), or a list of applications."""

    def refuse(self, value: object) -> Refusal | None:
        """Return why the value is neither a tap nor a list of applications; None if allowed."""
        taps = [value] if isinstance(value, str) else value
        if not isinstance(taps, (list, tuple)) or not all(isinstance(tap, str) for tap in taps):
            return Refusal("is not a tap or a list of taps", self.allowed)
        if not taps:
            return Refusal("is an empty list", self.allowed)
        for tap in taps:
            if refusal := super().refuse(tap):
                return refusal
        if len(taps) > 1 and {parse_tap(tap).kind for tap in taps} != {"app"}:
            return Refusal(
                "has several taps that are not all applications", "one tap, or app:NAME each"
            )
        return None

    def json_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of one address or a list of addresses."""
        one = super().json_schema()
        return {"anyOf": [one, {"type": "array", "minItems": 1, "items": one}]}

    def typed(self, value: Any) -> Any:
        """Return the addresses as a tuple."""
        return (value,) if isinstance(value, str) else tuple(value)


@dataclass(frozen=True)
class Names(Description):
    """A list of non-blank names."""

    @property
    def allowed(self) -> str:
        """The allowed form, for messages."""
        return '["NAME", ...]'

    def refuse(self, value: object) -> Refusal | None:
        """Return why the value is not a list of non-blank names; None if it is allowed."""
        names = value if isinstance(value, (list, tuple)) else [None]
        if all(isinstance(name, str) and name.strip() for name in names):
            return None
        return Refusal("must be a list of non-empty strings", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of an array of non-blank strings."""
        return {"type": "array", "items": {"type": "string", "pattern": r"\S"}}

    def typed(self, value: Any) -> Any:
        """Return the names as a tuple."""
        return tuple(value)

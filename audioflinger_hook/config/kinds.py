"""Kinds of values that only settings have: rigs, files, addresses and names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from audioflinger_hook.sources import parse_tap
from device.errors import UsageError
from device.rig.rig import SHIPPED, SUFFIX, read_rig
from device.values import Description, Refusal, Text


@dataclass(frozen=True)
class RigName(Text):
    """A bundled rig or a rig file, which must be readable and valid."""

    grammar: str = f"{', '.join(SHIPPED)}, or a file, NAME{SUFFIX}"

    def resolved(self, value: object, folder: Path) -> object:
        """Return the value; the path of a rig file is resolved against the folder."""
        is_file = isinstance(value, str) and value not in SHIPPED and value.endswith(SUFFIX)
        return str(folder / str(value)) if is_file else value

    def refuse(self, value: object) -> Refusal | None:
        """Refuse unknown names, and files that are no rig."""
        if not isinstance(value, str):
            return Refusal("is not a name", self.allowed)
        if value in SHIPPED:
            return None
        if not value.endswith(SUFFIX):
            return Refusal("is not known", self.allowed)
        try:
            read_rig(value)
        except (UsageError, ValueError) as error:  # ValueError: an impossible path
            return Refusal(f"cannot be used ({error})", self.allowed)
        return None


@dataclass(frozen=True)
class FileName(Text):
    """The path of a file. A value of type `Path` is checked only when the file is opened."""

    def resolved(self, value: object, folder: Path) -> object:
        """Return the value; a relative path is resolved against the folder."""
        return str(folder / value) if isinstance(value, str) and value else value

    def refuse(self, value: object) -> Refusal | None:
        """Refuse other values than the path of a file."""
        if isinstance(value, Path):
            return None
        if not isinstance(value, str) or not value:
            return Refusal("is not a path", self.allowed)
        good = "\0" not in value and Path(value).is_file()
        return None if good else Refusal("is not a file", self.allowed)

    def typed(self, value: Any) -> Any:
        """Return a path."""
        return Path(value)


@dataclass(frozen=True)
class Address(Text):
    """The address of a tap or a device, as the user writes it."""

    parse: Callable[[str], object] = str
    what: str = "address"

    def refuse(self, value: object) -> Refusal | None:
        """Refuse what the grammar refuses, in its words."""
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
    """The address of one tap, or a list of applications."""

    def refuse(self, value: object) -> Refusal | None:
        """Refuse other values than one tap or a list of applications."""
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
                "are several taps, but not all are applications", "one tap, or app:NAME each"
            )
        return None

    def json_schema(self) -> dict[str, Any]:
        """Return an address or a list of them."""
        one = super().json_schema()
        return {"anyOf": [one, {"type": "array", "minItems": 1, "items": one}]}

    def typed(self, value: Any) -> Any:
        """Return a tuple of addresses."""
        return (value,) if isinstance(value, str) else tuple(value)


@dataclass(frozen=True)
class Names(Description):
    """A list of names, none of them blank."""

    @property
    def allowed(self) -> str:
        """A list of names."""
        return '["NAME", ...]'

    def refuse(self, value: object) -> Refusal | None:
        """Refuse other values than a list of names."""
        names = value if isinstance(value, (list, tuple)) else [None]
        if all(isinstance(name, str) and name.strip() for name in names):
            return None
        return Refusal("must be a list of non-empty strings", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        """Return an array of strings."""
        return {"type": "array", "items": {"type": "string", "pattern": r"\S"}}

    def typed(self, value: Any) -> Any:
        """Return a tuple."""
        return tuple(value)

"""The user's rules, which select the applications to capture. Pure functions on a snapshot.

    NAME              the application's name, id or binary
    application:NAME  the application's name or id
    binary:NAME       the program's file name
    role:NAME         the role of the sound, such as video, music or game

Case is ignored. NAME must match a whole name, id or role; `*`, `?` and `[...]` match as in a shell.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

from device.errors import UsageError
from device.server.identity import is_ours
from device.server.snapshot import ServerSnapshot, Stream

# roles (PulseAudio) and properties (PipeWire) of loopbacks and virtual sinks
_SERVER_ROLES = ("abstract", "filter")
_SERVER_PROPERTIES = ("node.link-group", "pulse.module.id")


@dataclass(frozen=True)
class Rule:
    """A rule. kind: "application", "binary", "role"; "" if not given. name: NAME, casefolded."""

    kind: str
    name: str

    @classmethod
    def parse(cls, text: str) -> "Rule":
        """Parse a user's rule. UsageError: it has no name, or an empty or unknown kind."""
        before, colon, after = text.partition(":")
        kind, name = (part.strip().casefold() for part in (before, after if colon else text))
        kind = kind if colon else ""
        if not name or kind not in ("", "application", "binary", "role") or (colon and not kind):
            raise UsageError(
                f"the rule {text!r} for applications is invalid; write NAME, application:NAME, "
                "binary:NAME or role:NAME, and the last three for a name with a colon"
            )
        return cls(kind, name)

    def matches(self, stream: Stream) -> bool:
        """Whether the rule matches this stream; an unknown property matches no rule."""
        known = self._names(stream)
        return self.name in known or any(fnmatchcase(name, self.name) for name in known)

    def distance(self, stream: Stream) -> int:
        """Return 0 for the application's name, 1 for another name of it, 2 for a pattern."""
        own, name = app_name(stream).strip().casefold(), self.name.replace("[[]", "[")
        return 0 if name == own else 1 if name in self._names(stream) else 2

    def _names(self, stream: Stream) -> list[str]:
        names = (stream.application, stream.properties.get("application.id", ""))
        values = {
            "role": (stream.role,),
            "binary": (stream.binary,),
            "application": names,
            "": (stream.binary, *names),
        }
        return [value.strip().casefold() for value in values[self.kind] if value]


def first_match(rules: Iterable[tuple[Rule, Any]], stream: Stream) -> Any:
    """Return what the first matching rule has; rules with an exact name come first."""
    found = [one for one in rules if one[0].matches(stream)]
    return min(found, key=lambda one: one[0].distance(stream))[1] if found else None


Names = tuple[str, ...]
Feels = tuple[tuple[Rule, bool], ...]


class AppRules:
    """Selects the applications to capture. Immutable: any thread may use it.

    include: a stream must match at least one of these rules; () selects all applications. exclude:
    a stream must match none of these rules. feels: rules above both, each with whether it selects.
    UsageError: see `Rule.parse`.
    """

    def __init__(self, include: Names = (), exclude: Names = (), feels: Feels = ()) -> None:
        self.feels = feels
        self.include = tuple(map(Rule.parse, include))
        self.exclude = tuple(map(Rule.parse, exclude))

    def take(self, stream: Stream) -> bool:
        """Whether the rules select a stream, whatever made it and wherever it plays."""
        included = not self.include or any(rule.matches(stream) for rule in self.include)
        selected = included and not any(rule.matches(stream) for rule in self.exclude)
        feel: bool | None = first_match(self.feels, stream)
        return selected if feel is None else feel

    def select(
        self, snapshot: ServerSnapshot, haptic_sink: str | None = None
    ) -> tuple[Stream, ...]:
        """Return the selected applications' streams that play to any sink except haptic_sink."""
        return tuple(
            stream
            for stream in snapshot.sink_inputs
            if is_application(stream)
            and stream.device_index is not None
            and stream.device_name != haptic_sink
            and self.take(stream)
        )


def app_name(stream: Stream) -> str:
    """Return the application's name, else its binary, else the title of its sound."""
    return stream.application or stream.binary or stream.media


def is_application(stream: Stream) -> bool:
    """Whether a stream is neither ours nor part of a loopback or virtual sink of the server."""
    of_server = stream.role in _SERVER_ROLES or any(
        name in stream.properties for name in _SERVER_PROPERTIES
    )
    return not (of_server or is_ours(stream))

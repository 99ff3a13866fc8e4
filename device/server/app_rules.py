"""Which applications are captured: rules of a user, on what plays at one moment.

A rule is one of

    NAME              the application's name, id or binary
    application:NAME  its name or id
    binary:NAME       the program's file, without its folder
    role:NAME         what it says it plays: video, music, game, event, phone, animation,
                      production, a11y, test

Case does not matter. NAME is matched whole; `*`, `?` and `[...]` in it stand for other characters,
as in a shell. Pure functions on a snapshot; any thread may call them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase

from device.errors import UsageError
from device.server.identity import is_own_stream
from device.server.snapshot import ServerSnapshot, Stream
from device.stream.pcms import APPLICATION_ID, ROLE, TAG

_KINDS = ("application", "binary", "role")
_SERVER_ROLES = ("abstract", "filter")
"""What PulseAudio's loopbacks and virtual sinks say that they play."""

_SERVER_PROPERTIES = ("node.link-group", "pulse.module.id")
"""What PipeWire's loopbacks and virtual sinks have, and no application."""


@dataclass(frozen=True)
class Rule:
    """One rule. kind: "application", "binary", "role", or "" for a name alone; name: casefolded."""

    kind: str
    name: str

    @classmethod
    def parse(cls, text: str) -> Rule:
        """The rule that a user wrote.

        Raises
        ------
        UsageError
            It is empty, or of a kind that there is not.
        """
        kind, colon, name = text.partition(":")
        kind = kind.strip().casefold()
        if not colon:
            kind, name = "", text
        elif kind not in _KINDS:
            raise UsageError(
                f"no rule for applications can be {text!r}: before the colon stands application, "
                "binary or role; a name that has a colon itself is written application:NAME"
            )
        name = name.strip().casefold()
        if not name:
            raise UsageError(
                f"a rule for applications names nothing: {text!r}; write NAME, application:NAME, "
                "binary:NAME or role:NAME"
            )
        return cls(kind, name)

    def matches(self, stream: Stream) -> bool:
        """Whether the rule is about this stream; what an application does not say never matches."""
        return any(
            value.casefold() == self.name or fnmatchcase(value.casefold(), self.name)
            for value in self._values(stream)
            if value
        )

    def _values(self, stream: Stream) -> Iterator[str]:
        if self.kind == "role":
            yield stream.role
        if self.kind in ("", "binary"):
            yield stream.binary
        if self.kind in ("", "application"):
            yield stream.application
            yield stream.properties.get("application.id", "")


class AppRules:
    """Selects the applications to capture. A value that any thread may read.

    include: rules, of which a stream has to match one; () for all applications. exclude: rules, of
    which it may match none; they come before those of `include`.

    Raises
    ------
    UsageError
        A rule is empty, or of a kind that there is not.
    """

    def __init__(self, include: tuple[str, ...] = (), exclude: tuple[str, ...] = ()) -> None:
        self.include = tuple(Rule.parse(text) for text in include)
        self.exclude = tuple(Rule.parse(text) for text in exclude)

    def select(
        self, snapshot: ServerSnapshot, haptic_sink: str | None = None
    ) -> tuple[Stream, ...]:
        """The streams to capture, in the server's order; paused and muted ones are among them.

        haptic_sink: name of the sink that the vibration goes to. What plays there, or nowhere yet,
        is left out; so are our own streams, and those by which the server itself passes sound on
        (loopbacks, virtual sinks): that sound is captured where it comes from.
        """
        return tuple(
            stream
            for stream in _of_applications(snapshot)
            if stream.place is not None
            and (haptic_sink is None or stream.device_name != haptic_sink)
            and (not self.include or any(rule.matches(stream) for rule in self.include))
            and not any(rule.matches(stream) for rule in self.exclude)
        )


def suggest_apps(text: str, snapshot: ServerSnapshot) -> tuple[str, ...]:
    """Up to three names of applications that play now and resemble a rule; all if none does.

    text: the rule, with or without its kind. For an error message.
    """
    names = {app_name(stream) for stream in _of_applications(snapshot)} - {""}
    known = {name.casefold(): name for name in sorted(names)}
    for stream in _of_applications(snapshot):
        if stream.binary and app_name(stream):
            known.setdefault(stream.binary.casefold(), app_name(stream))
    kind, _, rest = text.casefold().partition(":")
    wanted = (rest if kind in _KINDS else text.casefold()).strip()
    close = get_close_matches(wanted, known, n=3, cutoff=0.5)
    found = dict.fromkeys(known[name] for name in close)
    return tuple(found) or tuple(sorted(names))


def app_name(stream: Stream) -> str:
    """What a stream's application is called: by its name, else its binary, else what it plays."""
    return stream.application or stream.binary or stream.media


def _of_applications(snapshot: ServerSnapshot) -> Iterator[Stream]:
    return (
        stream
        for stream in snapshot.sink_inputs
        if not _is_ours(stream) and not _is_of_server(stream)
    )


def _is_ours(stream: Stream) -> bool:
    return (
        stream.role == ROLE
        or TAG in stream.properties
        or stream.properties.get("application.id") == APPLICATION_ID
        or is_own_stream(stream)
    )


def _is_of_server(stream: Stream) -> bool:
    return stream.role in _SERVER_ROLES or any(
        name in stream.properties for name in _SERVER_PROPERTIES
    )

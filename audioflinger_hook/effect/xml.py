"""Parser of audio_effects.xml 2.0, which lists effects and the streams that they process."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from uuid import UUID
from xml.parsers import expat

from audioflinger_hook.effect.registry import EffectRegistry
from device.errors import UsageError

SIZE_MAX = 2**20  # bytes
VERSION = "2.0"

# The mix of all players. Android's files do not have this stream.
OUTPUT_MIX_STREAM = "output_mix"
STREAMS = (
    *(OUTPUT_MIX_STREAM, "alarm", "assistant", "bluetooth_sco", "dtmf", "enforced_audible"),
    *("music", "notification", "ring", "system", "tts", "voice_call"),
)

ROOT = "audio_effects_conf"
CHILDREN: dict[str, tuple[str, ...]] = {
    "": (ROOT,),
    ROOT: ("libraries", "effects", "postprocess", "preprocess", "deviceEffects"),
    "libraries": ("library",),
    "effects": ("effect", "effectProxy"),
    "postprocess": ("stream",),
    "stream": ("apply",),
}
NOT_EMULATED = ("preprocess", "deviceEffects", "effectProxy")  # ignored elements


@dataclass(frozen=True)
class Finding:
    """A problem in a file. line: line number, from 1."""

    line: int
    text: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.text}"


@dataclass
class DeclaredEffects:
    """Effects that a file declares and the registry contains. problems: errors in the file."""

    effects: dict[str, UUID] = field(default_factory=dict)
    postprocess: dict[str, list[UUID]] = field(default_factory=dict)  # by the name of a stream
    problems: list[Finding] = field(default_factory=list)


def bundled_effects(registry: EffectRegistry) -> DeclaredEffects:
    """Return the declarations of the bundled file: the haptic effect on the output mix."""
    xml = files("audioflinger_hook.effect").joinpath("audio_effects.xml").read_bytes()
    return parse_effects(xml, registry)


def read_effects(path: Path, registry: EffectRegistry) -> DeclaredEffects:
    """Return the declarations of a file. UsageError: the file cannot be read or is too large."""
    try:
        with path.open("rb") as stream:
            xml = stream.read(SIZE_MAX + 1)
    except OSError as error:
        raise UsageError(
            f"{path} cannot be read ({error.strerror}); give the path of an audio_effects.xml"
        ) from None
    if len(xml) > SIZE_MAX:
        raise UsageError(f"{path} is too large for an audio_effects.xml; allowed: {SIZE_MAX} bytes")
    return parse_effects(xml, registry)


def parse_effects(xml: bytes, registry: EffectRegistry) -> DeclaredEffects:
    """Return the declarations of an XML document; never raises, even for arbitrary bytes.

    `problems` lists invalid elements. The parser stops at a syntax error or a DOCTYPE declaration.
    """
    declared = DeclaredEffects()
    _Resolver(registry, declared).resolve(_elements(xml, declared.problems))
    declared.problems.sort(key=lambda finding: finding.line)
    return declared


@dataclass(frozen=True)
class _Element:
    line: int
    name: str
    attributes: dict[str, str]


class _Refused(Exception):
    """The document contains invalid data."""


def _elements(xml: bytes, problems: list[Finding]) -> list[_Element]:
    """Return the elements at allowed places; stop at a syntax error or a DOCTYPE declaration."""
    found: list[_Element] = []
    parents = [""]
    parser = expat.ParserCreate()
    skipped = 0  # nesting depth inside an ignored element

    def doctype(*_: object) -> None:
        # A few lines of nested entities can expand to gigabytes.
        raise _Refused("a document type, with its entities, is not allowed")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal skipped
        line, parent = parser.CurrentLineNumber, parents[-1]
        if skipped:
            skipped += 1
        elif name not in CHILDREN.get(parent, ()):
            place = f"in <{parent}>" if parent else "at the top"
            problems.append(Finding(line, f"<{name}> does not belong {place}; left out"))
            skipped = 1
        elif name in NOT_EMULATED:
            skipped = 1
        else:
            parents.append(name)
            found.append(_Element(line, name, attributes))

    def end(_: str) -> None:
        nonlocal skipped
        if skipped:
            skipped -= 1
        else:
            parents.pop()

    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as error:
        reason = f"is not XML ({expat.ErrorString(error.code)}); nothing after it is read"
        problems.append(Finding(error.lineno, reason))
    except (_Refused, ValueError, LookupError) as error:
        problems.append(Finding(parser.CurrentLineNumber, f"{error}; nothing after it is read"))
    return found


class _Resolver:
    def __init__(self, registry: EffectRegistry, declared: DeclaredEffects) -> None:
        self._registry = registry
        self._declared = declared
        self._libraries: dict[str, str] = {}
        self._applied: list[UUID] | None = None

    def resolve(self, elements: list[_Element]) -> None:
        """Evaluate all elements by kind, so that an effect may precede its library."""
        passes: tuple[dict[str, Callable[[dict[str, str]], None]], ...] = (
            {ROOT: self._root},
            {"library": self._library},
            {"effect": self._effect},
            {"stream": self._stream, "apply": self._apply},
        )
        for takers in passes:
            for element in elements:
                if take := takers.get(element.name):
                    try:
                        take(element.attributes)
                    except _Refused as refused:
                        text = f"<{element.name}> {refused}"
                        self._declared.problems.append(Finding(element.line, text))

    def _root(self, attributes: dict[str, str]) -> None:
        if attributes.get("version") != VERSION:
            version = attributes.get("version")
            raise _Refused(f"version={version!r} is not {VERSION}; read as if it were")

    def _library(self, attributes: dict[str, str]) -> None:
        name, path = _needed(attributes, "name", "path")
        if name in self._libraries:
            raise _Refused(f"name={name!r} is declared twice; the second is left out")
        if path not in self._registry.libraries:
            there = ", ".join(self._registry.libraries)
            raise _Refused(f"path={path!r} is an unknown library; left out; there are: {there}")
        self._libraries[name] = path

    def _effect(self, attributes: dict[str, str]) -> None:
        effects = self._declared.effects
        name, library, text = _needed(attributes, "name", "library", "uuid")
        if name in effects:
            raise _Refused(f"name={name!r} is declared twice; the second is left out")
        if library not in self._libraries:
            raise _Refused(f"library={library!r} is an unknown library; {name!r} is left out")
        if not re.fullmatch(r"[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}", text):
            raise _Refused(f"uuid={text!r} is not a UUID; {name!r} is left out")
        uuid = UUID(text)
        if uuid in effects.values():
            raise _Refused(f"uuid={text!r} is a duplicate UUID; {name!r} is left out")
        if uuid not in self._registry.uuids(self._libraries[library]):
            raise _Refused(f"uuid={text!r} is not in library {library!r}; {name!r} is left out")
        effects[name] = uuid

    def _stream(self, attributes: dict[str, str]) -> None:
        self._applied = None
        (kind,) = _needed(attributes, "type")
        if kind not in STREAMS:
            raise _Refused(f"type={kind!r} is an unknown stream; left out with all it applies")
        self._applied = self._declared.postprocess.setdefault(kind, [])

    def _apply(self, attributes: dict[str, str]) -> None:
        (name,) = _needed(attributes, "effect")
        if name not in self._declared.effects:
            raise _Refused(f"effect={name!r} is an unknown effect; left out")
        if self._applied is None:
            return  # the stream is invalid, and `problems` lists it already
        if (uuid := self._declared.effects[name]) in self._applied:
            raise _Refused(f"effect={name!r} is applied twice; the second is left out")
        self._applied.append(uuid)


def _needed(attributes: dict[str, str], *names: str) -> list[str]:
    if missing := [name for name in names if not attributes.get(name)]:
        raise _Refused(f"has no {' and no '.join(missing)}; left out")
    return [attributes[name] for name in names]

"""Generates the reference in docs/api.md from signatures and docstrings."""

import inspect
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from enum import Enum
from types import FunctionType
from typing import Any

from audioflinger_hook import HapticTransform, Settings, TransformParameters, render_file
from audioflinger_hook.effect import interface
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.offline.render import RenderReport
from device import errors
from device.drive import ActuatorSettings
from device.values import Described

CHAPTERS: dict[str, tuple[Any, ...]] = {
    "Sound to vibration": (HapticTransform, TransformParameters),
    "Files": (render_file, RenderReport),
    "Settings": (Settings, ActuatorSettings),
    "Effects": (
        *(interface.EffectEngine, interface.EffectDescriptor, interface.EffectLibrary),
        *(interface.Parameter, MixBuffer),
    ),
    "Errors": (
        *(errors.CushionError, errors.UsageError, errors.NotFoundError, errors.LostError),
        *(errors.InternalError, errors.WriteError),
    ),
}

SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}\n", re.MULTILINE)
NAMED = re.compile(r"^(\w+(?:, \w+)*): ")


def api_reference() -> str:
    """Return signature and docstring of everything in `CHAPTERS`, including public members."""
    parts = []
    for chapter, things in CHAPTERS.items():
        parts.append(f"## {chapter}")
        parts += ["\n\n".join(_entry(thing)) for thing in things]
    return "\n\n".join(parts) + "\n"


def _entry(thing: Any) -> Iterator[str]:
    yield f"### {thing.__name__}"
    yield f"`from {_home(thing)} import {thing.__name__}`"
    if inspect.isfunction(thing):
        yield _signature(thing.__name__, thing)
        yield _document(thing)
        return
    is_record = is_dataclass(thing) or issubclass(thing, (Enum, Exception))
    if not is_record and not getattr(thing, "_is_protocol", False):
        yield _signature(thing.__name__, thing)
    yield _document(thing)
    if issubclass(thing, Described) and "\nAttributes\n" not in (inspect.getdoc(thing) or ""):
        rows = [
            f"| `{name}` | {described.allowed} | {described.meaning} |".replace("\n", " ")
            for name, described in thing.DESCRIPTIONS.items()
        ]
        yield "\n".join(["| field | allowed | meaning |", "| --- | --- | --- |", *rows])
    for name, member in vars(thing).items():
        if name.startswith("_") or not inspect.getdoc(member):
            continue
        if isinstance(member, property):
            yield f"**`{name}`** (property)"
            yield _document(member)
        elif isinstance(member, FunctionType):
            yield _signature(f"{thing.__name__}.{name}", member)
            yield _document(member)


def _home(thing: Any) -> str:
    """Return the outermost package whose `__all__` contains an object, else the object's module."""
    names = thing.__module__.split(".")
    for count in range(1, len(names)):
        package = __import__(".".join(names[:count]), fromlist=["__all__"])
        if thing.__name__ in getattr(package, "__all__", ()):
            return ".".join(names[:count])
    return str(thing.__module__)


def _signature(name: str, called: Any) -> str:
    """Return a call's signature without types, on several lines if it is long."""
    found = inspect.signature(called)
    shown: list[str] = []
    keyword = False
    for one in found.parameters.values():
        if one.name == "self":
            continue
        if one.kind is inspect.Parameter.KEYWORD_ONLY and not keyword:
            shown, keyword = [*shown, "*"], True
        default = "" if one.default is inspect.Parameter.empty else f"={one.default!r}"
        shown.append(f"{one.name}{default}")
    call = f"{name}({', '.join(shown)})"
    if len(call) > 90:
        call = f"{name}(\n    " + ",\n    ".join(shown) + ",\n)"
    return f"```text\n{call}\n```"


def _document(thing: Any) -> str:
    text = inspect.getdoc(thing) or ""
    head, *sections = SECTION.split(text)
    parts = [_plain(head)]
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        parts.append(f"**{title}**\n\n{_terms(body)}")
    return "\n\n".join(part for part in parts if part)


def _plain(text: str) -> str:
    """Return text as Markdown; lines that start with names and a colon become list items."""
    paragraphs = []
    for paragraph in text.strip().split("\n\n"):
        items: list[str] = []
        for line in paragraph.split("\n"):
            named = NAMED.match(line)
            if named or not items or line.startswith("- "):
                term = f"- `{named[1]}`: " if named else ""
                before = ["", ""] if items and not items[-1].startswith("- ") else [""]
                items += [*before[1:], term + _escape(line[named.end() if named else 0 :])]
            else:
                items[-1] += f" {_escape(line.strip())}"
        paragraphs.append("\n".join(items))
    return "\n\n".join(paragraphs)


def _terms(body: str) -> str:
    items = []
    for line in body.strip().split("\n"):
        if line and not line.startswith(" "):
            name, _, kind = line.partition(" : ")
            items.append(f"- `{name}`" + (f" ({_escape(kind)})" if kind else "") + ":")
        elif items and line.strip():
            items[-1] += f" {_escape(line.strip())}"
    return "\n".join(items)


def _escape(text: str) -> str:
    pieces = text.split("`")
    for place in range(0, len(pieces), 2):
        pieces[place] = re.sub(r"([*_\[\]<])", r"\\\1", pieces[place])
    return "`".join(pieces)

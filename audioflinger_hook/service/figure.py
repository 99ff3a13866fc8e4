"""What is known of each figure of the status: one table, the fields of `service/status.py`.

The status as text, `--json`, Prometheus, the live page and docs/figures.md all read the table. So a
new figure is a new field there, and the value that `daemon/status_report.py` or `read` gives it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, is_dataclass, replace
from enum import Enum
from operator import attrgetter
from types import NoneType
from typing import Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from audioflinger_hook.service.one_line import one_line
from device.units import db_to_amplitude

T = TypeVar("T")

UNITS = {
    "percent": ("%", ".1f"),
    "dbfs": ("dBFS", ".1f"),
    "m_s2": ("m/s²", ".3g"),
    "ppm": ("ppm", "+.1f"),
    "hz": ("Hz", ".1f"),
    "ms": ("ms", ".1f"),
    "mm": ("mm", ".2f"),
    "ohm": ("Ω", ".2f"),
    "db": ("dB", "+.1f"),
    "c": ("°C", ".0f"),
    "s": ("s", ".1f"),
}
"""Unit and format of a figure, by the last word of its name."""

BASE: dict[str, Callable[[Any], float]] = {
    "ms": lambda ms: 1e-3 * ms,
    "mm": lambda mm: 1e-3 * mm,
    "ppm": lambda ppm: 1.0 + 1e-6 * ppm,
    "dBFS": db_to_amplitude,
}
"""From a unit to that of Prometheus, where it is another."""

KINDS = {bool: "flag", int: "count", float: "gauge", str: "text"}

LINES_MAX = 20  # lines of a list of texts that are shown, the latest


@dataclass(frozen=True)
class Figure:
    """What is known of a figure, or of a group of them, apart from its name and type.

    row: of the text, shared by all figures of a group; by default the name of a figure of the
    status that has `show` or `panel`. metric: name in Prometheus, in base units and without
    `_total`, and in brackets the label that tells figures of one metric apart.
    """

    help: str
    unit: str = ""  # like kind and label: where it does not follow from name and type
    kind: str = ""
    label: str = ""
    read: str = ""  # attribute of a source of `gathered`, by default the name
    scale: float | None = None  # factor on what is read
    show: str | Callable[[Any], str] | None = None  # format; by default label, value and unit
    quiet: object = None  # a value that is not shown; nothing and no are not shown either
    tone: str | Callable[[Any], str] = ""  # "good", "wait" or "bad" of a value that is not 0
    row: str = ""
    panel: str = ""  # of the live page, where it shows the row
    metric: str = ""
    words: tuple[str, ...] = ()  # of a state

    def tone_of(self, value: Any) -> str:
        """Return the tone of a value, "" for none."""
        return self.tone(value) if callable(self.tone) else self.tone if value else ""


def figure(meaning: str, default: Any = MISSING, **known: Any) -> Any:
    """Return a dataclass field with a `Figure`."""
    metadata = {"figure": Figure(meaning, **known)}
    if callable(default):
        return dataclasses.field(default_factory=default, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


TOP, HIDDEN = Figure(""), Figure("")
"""Of the status, each of whose figures may have a row; of a group whose figures have none."""


_TABLES: dict[Any, list[tuple[str, Figure, Any]]] = {}


class Entry(NamedTuple):
    """One figure of the table."""

    path: tuple[str, ...]  # names of the groups that it lies in, and its own
    figure: Figure
    type: Any
    group: Any  # the dataclass that has the field

    @property
    def unit(self) -> str:
        """The unit, "" for none."""
        return self.figure.unit or _split(self.path[-1])[1]

    @property
    def kind(self) -> str:
        """What it is: gauge, count, flag, state or text; "" for a group."""
        kind = "" if is_dataclass(self.type) else KINDS.get(self.type, "state")
        return self.figure.kind or kind

    @property
    def label(self) -> tuple[str, str]:
        """Name and value of the metric's label; "" and "" for none."""
        by = self.figure.metric.partition("{")[2].rstrip("}")
        return by.lstrip("^"), by and _split(self.path[-2 if by[0] == "^" else -1])[0]

    def base(self, value: Any) -> float:
        """Return a value in the base unit of Prometheus."""
        return BASE.get(self.unit, float)(value)


def table(kind: Any) -> list[tuple[str, Figure, Any]]:
    """Return name, figure and type of each field of a dataclass; None is taken out of types."""
    if kind in _TABLES:
        return _TABLES[kind]
    found, hints = [], get_type_hints(kind)
    for field in dataclasses.fields(kind):
        hint = hints[field.name]
        if NoneType in get_args(hint):
            hint = next(one for one in get_args(hint) if one is not NoneType)
        found.append((field.name, field.metadata["figure"], hint))
    _TABLES[kind] = found
    return found


def entries(kind: type[Any], path: tuple[str, ...] = ()) -> Iterator[Entry]:
    """Yield each figure and group of a dataclass; the name of a list or a mapping ends in []."""
    for name, known, inner in table(kind):
        if get_origin(inner) is not None:
            listed = get_origin(inner) is tuple
            name, inner = f"{name}[]", get_args(inner)[0 if listed else 1]
        yield Entry((*path, name), known, inner, kind)
        if is_dataclass(inner):
            yield from entries(inner, (*path, name))  # type: ignore[arg-type]


def metrics(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[Entry, Any]]:
    """Yield entry and value of each figure that has a metric, and a value now."""
    for name, known, inner in table(type(group)):
        value = getattr(group, name)
        if is_dataclass(value):
            yield from metrics(value, (*path, name))
        elif known.metric and value is not None:
            yield Entry((*path, name), known, inner, type(group)), value


def gathered(kind: type[T], *sources: object, **given: Any) -> T:
    """Return a dataclass of figures: those given, each other one from the first source that has it.

    TypeError: a figure has neither a source nor a default.
    """
    for name, known, _ in table(kind):
        read = known.read or name
        first = read.partition(".")[0]
        source = next((one for one in sources if hasattr(one, first)), None)
        if name not in given and source is not None:
            value = attrgetter(read)(source)
            given[name] = value if known.scale is None or value is None else known.scale * value
    return kind(**given)


class Piece(NamedTuple):
    """A part of a row."""

    text: str
    tone: str


@dataclass(frozen=True)
class Row:
    """One row of the status."""

    label: str
    pieces: list[Piece]
    panel: str = ""  # of the live page, "" for none
    help: str = ""

    def __str__(self) -> str:
        return "".join(text for text, _ in self.parts)

    @property
    def parts(self) -> list[Piece]:
        """The pieces with what stands between; a space or a colon continues what was before."""
        first, *more = self.pieces
        rest = (Piece(text if text[0] in " :" else f", {text}", tone) for text, tone in more)
        return [first, *rest]


def rows(group: Any, owner: Figure = TOP) -> list[Row]:
    """Return the rows of a status, in the order of its fields; lists come last."""
    found: dict[str, Row] = {}
    for piece, own in _pieces(group, owner):
        found.setdefault(own.row, Row(own.row, [], own.panel, own.help)).pieces.append(piece)
    shown = [*found.values()]
    for name, known, _ in table(type(group)):
        value = getattr(group, name)
        if isinstance(value, tuple) and known.row and known.show is None:
            shown += _rows_of_list(known, value)
    return shown


def label_of(name: str, known: Figure) -> str:
    """Return what a figure is called in text: its name in words without unit, or its label."""
    return known.label or _split(name)[0].replace("_", " ")


def _rows_of_list(known: Figure, items: tuple[Any, ...]) -> Iterator[Row]:
    if items and not is_dataclass(items[0]):
        left_out = len(items) - LINES_MAX
        lines = [f"({left_out} earlier ones left out)"] if left_out > 0 else []
        for line in [*lines, *map(one_line, items[-LINES_MAX:])]:
            yield Row(known.row, [Piece(line, known.tone_of(line))], known.panel, known.help)
        return
    for number, item in enumerate(items, 1):
        first, *more = rows(item, replace(known, row=f"{known.row} {number}"))
        yield first
        yield from (replace(row, label=f"  {row.label}") for row in more)


def _pieces(group: Any, owner: Figure) -> Iterator[tuple[Piece, Figure]]:
    """Yield each piece that is shown of a group, with the figure that its row belongs to."""
    for name, known, _ in table(type(group)):
        value = getattr(group, name)
        if value in (None, "", ()) or value == known.quiet:
            continue
        own = known if known.row else owner
        if owner is TOP and not known.row:
            is_row = known.show is not None or known.panel
            own = replace(known, row=label_of(name, known)) if is_row else HIDDEN
        has_parts = is_dataclass(value) or isinstance(value, (tuple, Mapping))
        is_shown = own.row and (known.show is not None or not has_parts)
        if is_shown and (text := _shown(name, known, value)):
            yield Piece(text, known.tone_of(value)), own
        if is_dataclass(value):
            yield from _pieces(value, own if known.show is None else HIDDEN)


def _shown(name: str, known: Figure, value: Any) -> str:
    value = value.value if isinstance(value, Enum) else value
    value = one_line(value) if isinstance(value, str) else value
    if callable(known.show):
        return known.show(value)
    if known.show is not None:
        return known.show.format(value)
    _, unit, form = _split(name)
    label = label_of(name, known)
    if isinstance(value, bool):
        return label if value else ""
    number = format(value, form) if isinstance(value, float) else str(value)
    return f"{label} {number} {known.unit or unit}".rstrip()


def _split(name: str) -> tuple[str, str, str]:
    """Return a figure's name without its unit, the unit, and its format."""
    for ending, (unit, form) in UNITS.items():
        if name == ending or name.endswith(f"_{ending}"):
            return name.removesuffix(ending).rstrip("_") or name, unit, form
    return name, "", ".2f"

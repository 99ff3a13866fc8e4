"""Descriptions of the status figures: the values that are fields in `service/status.py`.

The text and JSON forms of the status, Prometheus, the live page and docs/figures.md use these
fields. A new field gets its value from `daemon/status_report.py` or through `Figure.read`.
"""

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

UNITS = {  # last word of a figure's name: (unit, format)
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

BASE: dict[str, Callable[[Any], float]] = {  # conversions of units to base units of Prometheus
    "ms": lambda ms: 1e-3 * ms,
    "mm": lambda mm: 1e-3 * mm,
    "ppm": lambda ppm: 1.0 + 1e-6 * ppm,
    "dBFS": db_to_amplitude,
}

KINDS = {bool: "flag", int: "count", float: "gauge", str: "text"}

LINES_MAX = 20  # a list of texts shows at most this number of lines


@dataclass(frozen=True)
class Figure:
    """Description of a figure, or of a group of figures.

    row: label of the row in the text form. Figures with the same label share a row. By default, a
    figure of `Status` with `show` or `panel` has its own row, and a group's figures share a row.
    metric: name in Prometheus, without `_total`. A label in braces distinguishes several figures of
    one metric. Its value is the figure's name; for a label with ^, it is the name of the group.
    """

    help: str
    unit: str = ""  # by default the unit in the name
    kind: str = ""  # see `Entry.kind`; by default determined by the type
    label: str = ""  # by default the words of the name
    read: str = ""  # attribute of a source in `gathered`; by default the name
    scale: float | None = None  # factor for the attribute
    show: str | Callable[[Any], str] | None = None  # format; by default label, value and unit
    quiet: object = None  # this value is not shown; None, "" and () are never shown
    tone: str | Callable[[Any], str] = ""  # tone of true values: "good", "wait", "bad", ...
    row: str = ""
    panel: str = ""  # panel of the live page that shows the row
    metric: str = ""
    words: tuple[str, ...] = ()  # possible values of a state

    def tone_of(self, value: Any) -> str:
        """Return the tone of a value, which determines its colour, or ""."""
        return self.tone(value) if callable(self.tone) else self.tone if value else ""


def figure(meaning: str, default: Any = MISSING, **known: Any) -> Any:
    """Return a dataclass field with a `Figure`."""
    metadata = {"figure": Figure(meaning, **known)}
    if callable(default):
        return dataclasses.field(default_factory=default, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


TOP, HIDDEN = Figure(""), Figure("")
"""Parents of figures. TOP: the complete status. HIDDEN: its figures are not shown."""


_TABLES: dict[Any, list[tuple[str, Figure, Any]]] = {}


class Entry(NamedTuple):
    """A figure of the status, or a group of figures."""

    path: tuple[str, ...]  # names of the groups that contain the figure, then its own name
    figure: Figure
    type: Any
    group: Any  # dataclass that has the field

    @property
    def unit(self) -> str:
        """Unit of the value, or ""."""
        return self.figure.unit or _split(self.path[-1])[1]

    @property
    def kind(self) -> str:
        """One of gauge, count, flag, state and text; "" for a group."""
        kind = "" if is_dataclass(self.type) else KINDS.get(self.type, "state")
        return self.figure.kind or kind

    @property
    def label(self) -> tuple[str, str]:
        """Name and value of the metric's label; two empty strings without a label."""
        by = self.figure.metric.partition("{")[2].rstrip("}")
        return by.lstrip("^"), by and _split(self.path[-2 if by[0] == "^" else -1])[0]

    def base(self, value: Any) -> float:
        """Return a value in the base unit of Prometheus."""
        return BASE.get(self.unit, float)(value)


def table(kind: Any) -> list[tuple[str, Figure, Any]]:
    """Return name, figure and type of each field of a dataclass; a type `X | None` becomes X."""
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
    """Yield all figures and groups of a dataclass. Names of lists and mappings end in []."""
    for name, known, inner in table(kind):
        if get_origin(inner) is not None:
            listed = get_origin(inner) is tuple
            name, inner = f"{name}[]", get_args(inner)[0 if listed else 1]
        yield Entry((*path, name), known, inner, kind)
        if is_dataclass(inner):
            yield from entries(inner, (*path, name))  # type: ignore[arg-type]


def metrics(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[Entry, Any]]:
    """Yield entry and value of each figure that has a metric and a value."""
    for name, known, inner in table(type(group)):
        value = getattr(group, name)
        if is_dataclass(value):
            yield from metrics(value, (*path, name))
        elif known.metric and value is not None:
            yield Entry((*path, name), known, inner, type(group)), value


def gathered(kind: type[T], *sources: object, **given: Any) -> T:
    """Return a group with values from `given`, else from `sources`. TypeError: one is missing."""
    for name, known, _ in table(kind):
        read = known.read or name
        source = next((one for one in sources if hasattr(one, read.partition(".")[0])), None)
        if name not in given and source is not None:
            value = attrgetter(read)(source)
            given[name] = value if known.scale is None or value is None else known.scale * value
    return kind(**given)


class Piece(NamedTuple):
    """Part of a row's text."""

    text: str
    tone: str


@dataclass(frozen=True)
class Row:
    """One row of the status."""

    label: str
    pieces: list[Piece]
    panel: str = ""  # panel of the live page that shows the row, or ""
    help: str = ""

    def __str__(self) -> str:
        return "".join(text for text, _ in self.parts)

    @property
    def parts(self) -> list[Piece]:
        """Pieces, separated by ", " except before a piece that starts with a space or colon."""
        first, *more = self.pieces
        rest = (Piece(text if text[0] in " :" else f", {text}", tone) for text, tone in more)
        return [first, *rest]


def rows(group: Any, owner: Figure = TOP) -> list[Row]:
    """Return the rows of a group in the order of its fields, then the rows of its lists."""
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
    """Return a figure's label: by default the words of its name without the unit."""
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
    """Yield each visible piece of a group, with the figure that describes its row."""
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
    """Split a figure's name; return the name without unit, the unit and the number format."""
    for ending, (unit, form) in UNITS.items():
        if name == ending or name.endswith(f"_{ending}"):
            return name.removesuffix(ending).rstrip("_") or name, unit, form
    return name, "", ".2f"

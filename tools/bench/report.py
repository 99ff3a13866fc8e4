"""The report: measured rows by section, as Markdown to read and JSON to compute with.

The JSON document is the dataclasses below, field by field, in this shape (SCHEMA_VERSION 1;
report.schema.json beside this module says it as JSON Schema):

    {"schema": 1, "date": "...", "quick": bool, "duration_s": number, "machine": {MachineFacts},
     "must": {"met": int, "not_met": [name, ...], "met_in_ffts": [those of them, ...]},
     "sections": [{"title", "explanation", "rows": [{Row, "met"}], "missing": [{Missing}],
                   "series": {name: [number, ...]}, "footnote"}]}

A number that is not finite is null. `must` in a row is {"relation", "bound"} or null; `met` is
true, false, or null where nothing is asked; `lead` is like `must`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from tools.bench.cost import LIMITS_RFFT_S
from tools.bench.machine import MachineFacts

SCHEMA_VERSION = 1

MET, NOT_MET, MISSING = "met", "**not met**", "**missing**"
COMMAND = "python -m tools.bench"


@dataclass(frozen=True)
class Must:
    """A limit that a value has to keep: value <= bound, or value >= bound."""

    relation: Literal["<=", ">="]
    bound: float

    def met(self, value: float) -> bool:
        """Return whether a value keeps the limit; NaN never does."""
        return value <= self.bound if self.relation == "<=" else value >= self.bound

    def shown(self, unit: str) -> str:
        """Return the limit as text with its unit."""
        sign = {"<=": "≤", ">=": "≥"}[self.relation]
        bound = number(self.bound) if float(self.bound).is_integer() else f"{self.bound:g}"
        # "2 of 9" has a unit that only the count needs.
        return f"{sign} {_with_unit(bound, '' if unit.startswith('of ') else unit)}"


@dataclass(frozen=True)
class Row:
    """One measured value.

    name: what was measured; column: whose value it is (`live`, `reference`, ...), rows of one
    name share a line of the table. value: in `unit`, None where there is none to give (the note
    says why). low, high: the spread over repeats. must: the limit asked of it; lead: a closer one,
    which is aimed at. note: what a reader needs besides, for example where the worst case lies.
    ffts_column: of a limit of this machine's time, the column of the same name that asks the same
    in FFTs.
    """

    name: str
    value: float | None
    unit: str = ""
    column: str = "live"
    must: Must | None = None
    low: float | None = None
    high: float | None = None
    note: str = ""
    lead: Must | None = None
    ffts_column: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the limit is kept; None where none is asked or nothing was measured."""
        if self.must is None or self.value is None:
            return None
        return self.must.met(self.value)

    def shown(self) -> str:
        """Return the value with its spread and unit as text; no unit that the column names."""
        if self.value is None:
            return self.note or "-"
        unit = "" if self.unit in self.column.split() else self.unit
        value = _with_unit(number(self.value), unit)
        if self.low is None or self.high is None:
            return value
        return f"{value} ({number(self.low)} to {number(self.high)})"


@dataclass(frozen=True)
class Missing:
    """A row that could not be measured here: its name, the reason, and the command that helps."""

    name: str
    reason: str
    command: str

    def __str__(self) -> str:
        return f"{self.name}: {self.reason}; to enable it: {self.command}"


@dataclass(frozen=True)
class Section:
    """One bench's rows under a title, with a sentence on what they mean to a reader.

    series: the single measurements behind some rows, by name, for plots. footnote: how the rows
    came about, where that is more than a sentence.
    """

    title: str
    explanation: str
    rows: tuple[Row, ...]
    missing: tuple[Missing, ...] = ()
    series: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    footnote: str = ""

    def met_in_ffts(self, row: Row) -> bool:
        """Return whether a row has a twin in FFTs, and that keeps its limit."""
        return any(
            twin.met is True and (twin.name, twin.column) == (row.name, row.ffts_column)
            for twin in self.rows
        )


@dataclass(frozen=True)
class BenchReport:
    """Everything one run measured. date: UTC, ISO 8601; duration_s: wall time of the run."""

    date: str
    quick: bool
    duration_s: float
    machine: MachineFacts
    sections: tuple[Section, ...]

    @property
    def missing(self) -> tuple[Missing, ...]:
        """Every row that could not be measured."""
        return tuple(missing for section in self.sections for missing in section.missing)

    @property
    def not_met(self) -> tuple[tuple[str, Row], ...]:
        """Every row whose limit is not kept, with its full name: section, row, column."""
        return tuple(
            (_full_name(section, row), row)
            for section in self.sections
            for row in section.rows
            if row.met is False
        )

    @property
    def met_in_ffts(self) -> frozenset[str]:
        """The names of those of `not_met` that keep the same limit in FFTs: of a slow machine."""
        return frozenset(
            _full_name(section, row)
            for section in self.sections
            for row in section.rows
            if row.met is False and section.met_in_ffts(row)
        )

    @property
    def met_count(self) -> int:
        """How many rows keep the limit that is asked of them."""
        return sum(row.met is True for section in self.sections for row in section.rows)

    def section(self, title: str) -> Section:
        """Return the section of that title; KeyError where there is none."""
        return {section.title: section for section in self.sections}[title]

    def to_json(self) -> dict[str, Any]:
        """Return the report as what `json` writes; its shape stands at the top of this module."""
        document = {
            "schema": SCHEMA_VERSION,
            "date": self.date,
            "quick": self.quick,
            "duration_s": self.duration_s,
            "machine": asdict(self.machine),
            "must": {
                "met": self.met_count,
                "not_met": [name for name, _ in self.not_met],
                "met_in_ffts": [name for name, _ in self.not_met if name in self.met_in_ffts],
            },
            "sections": [
                {
                    "title": section.title,
                    "explanation": section.explanation,
                    "rows": [asdict(row) | {"met": row.met} for row in section.rows],
                    "missing": [asdict(missing) for missing in section.missing],
                    "series": {name: list(values) for name, values in section.series.items()},
                    "footnote": section.footnote,
                }
                for section in self.sections
            ],
        }
        finite: dict[str, Any] = _finite(document)
        return finite

    def to_markdown(self, pictures: Mapping[str, str] | None = None) -> str:
        """Return the report as a Markdown document.

        pictures: by the title of the section that they are shown in, as Markdown.
        """
        shown = pictures or {}
        sections = (_section_markdown(each, shown.get(each.title, "")) for each in self.sections)
        return "\n".join([self._header(), *sections])

    def _header(self) -> str:
        command = f"{COMMAND} --quick" if self.quick else COMMAND
        size = "the quick run" if self.quick else "the full run"
        machine = self.machine
        lines = [
            "# Speed and error, measured",
            "",
            f"`{command}` wrote this file and repeats it. Every number and every verdict is "
            "measured or computed by that command; nothing is typed by hand.",
            "",
            f"- **Run**: {self.date}, {size}, {self.duration_s:.0f} s.",
            f"- **Machine**: {machine.cpu}, {machine.cores} cores, {machine.system}, "
            f"load {machine.load_before:.1f} before the run.",
            f"- **Software**: Python {machine.python}, NumPy {machine.numpy}, "
            f"SciPy {machine.scipy}.",
            "- **Cost** is CPU time of the one thread that does the work, in ms for each second "
            "of 48 kHz stereo, median over repeats with the smallest and the largest in "
            "brackets. *FFTs* is the same cost as a multiple of one `scipy.fft.rfft` of 2048 "
            f"float32 samples ({machine.rfft_us:.1f} µs here), timed in turn with it: that "
            "number travels between machines, so limits of what a second or a block costs are "
            "asked in FFTs as well: as many as they are on a machine whose FFT takes "
            f"{1e6 * LIMITS_RFFT_S:g} µs.",
            "- **live** is the form of the transform that a cushion plays; **reference** is the "
            "paper's, literally. *must* is the limit the project set itself, *lead* a closer one "
            "that it aims at.",
            f"- **Result**: {self._result()}",
            *(f"  - not measured: {missing}" for missing in self.missing),
            "",
        ]
        return "\n".join(lines)

    def _result(self) -> str:
        """Return the count of limits met, then those that are not: faults before slowness."""
        slow = [(name, row) for name, row in self.not_met if name in self.met_in_ffts]
        faults = [(name, row) for name, row in self.not_met if name not in self.met_in_ffts]
        count = f"{self.met_count} of {self.met_count + len(self.not_met)} limits met"
        if slow:
            are = "1 is" if len(slow) == 1 else f"{len(slow)} are"
            count += f"; of the {len(self.not_met)} not met {are} met in FFTs"
        lines = [f"{count}.", *(f"  - not met: {name}, {_verdict(row)}" for name, row in faults)]
        if slow:
            lines.append(
                "  - not met in this machine's time only; met in FFTs, which travel between "
                "machines:"
            )
            lines += [f"    - {name}, {_verdict(row)}" for name, row in slow]
        return "\n".join(lines)


def number(value: float) -> str:
    """Return a number with three significant digits, in plain notation where that is short."""
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "-∞"}.get(value, "none")
    if value == 0.0:
        return "0"
    if float(value).is_integer() and abs(value) < 1e7:
        return f"{int(value):,}".replace(",", " ")
    if not 1e-4 <= abs(value) < 1e7:
        return f"{value:.1e}"
    if abs(value) >= 1000.0:
        return f"{round(value):,}".replace(",", " ")
    rounded = float(f"{value:.3g}")  # 9.996 has one digit less behind the point than it seems
    return f"{rounded:.{max(0, 2 - math.floor(math.log10(abs(rounded))))}f}"


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}" if unit else text


def _full_name(section: Section, row: Row) -> str:
    return f"{section.title}: {row.name} ({row.column})"


def _verdict(row: Row) -> str:
    return f"{row.shown()}, must {row.must.shown(row.unit)}" if row.must else row.shown()


def _section_markdown(section: Section, picture: str) -> str:
    columns = list(dict.fromkeys(row.column for row in section.rows))
    limited = any(row.must for row in section.rows)
    led = any(row.lead for row in section.rows)
    noted = any(row.note and row.value is not None for row in section.rows)
    heading = ["", *columns, *(["must", ""] if limited else [])]
    heading += [*(["lead", ""] if led else []), *(["note"] if noted else [])]
    lines = [f"## {section.title}", "", section.explanation, ""]
    lines += [picture, ""] if picture else []
    if section.rows:
        lines += [_line(heading), _line(["---"] * len(heading))]
    for name in dict.fromkeys(row.name for row in section.rows):
        mine = [row for row in section.rows if row.name == name]
        by_column = {row.column: row for row in mine}
        cells = [name, *(by_column[c].shown() if c in by_column else "" for c in columns)]
        if limited:
            cells += _limits_and_verdict([row for row in mine if row.met is not None])
        if led:
            cells += _lead_and_verdict([row for row in mine if row.lead])
        if noted:
            cells.append("; ".join(row.note for row in mine if row.note and row.value is not None))
        lines.append(_line(cells))
    if section.rows:
        blank = [""] * (len(heading) - 2)
        lines += [_line([missing.name, MISSING, *blank]) for missing in section.missing]
    lines += ["", *(f"Not measured: {missing}." for missing in section.missing), section.footnote]
    return "\n".join(lines).rstrip("\n") + "\n"


def _limits_and_verdict(asked: list[Row]) -> list[str]:
    """Return the limits of one line, each once, and whether all are met or which are not."""
    limits = dict.fromkeys(row.must.shown(row.unit) for row in asked if row.must)
    missed = [row.column for row in asked if not row.met]
    if not missed:
        return [", ".join(limits), MET if asked else ""]
    return [", ".join(limits), NOT_MET + (f": {'; '.join(missed)}" if len(asked) > 1 else "")]


def _lead_and_verdict(aimed: list[Row]) -> list[str]:
    """Return the closer limits of one line, each once, and whether all are kept."""
    limits = dict.fromkeys(row.lead.shown(row.unit) for row in aimed if row.lead)
    kept = all(row.lead.met(_plain(row.value)) for row in aimed if row.lead)
    return [", ".join(limits), "" if not aimed else MET if kept else NOT_MET]


def _plain(value: float | None) -> float:
    return math.nan if value is None else value


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |"


def _finite(item: Any) -> Any:
    """Return the document with None in place of every number that JSON does not know."""
    if isinstance(item, float):
        return item if math.isfinite(item) else None
    if isinstance(item, dict):
        return {key: _finite(entry) for key, entry in item.items()}
    if isinstance(item, (list, tuple)):
        return [_finite(entry) for entry in item]
    return item

"""The report of the benchmarks, and its conversion to Markdown and JSON.

The file report.schema.json in this folder describes the JSON document.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from tools.bench.cost import LIMITS_RFFT_S
from tools.bench.machine import MachineFacts

SCHEMA_VERSION = 1

MET, NOT_MET, MISSING = "met", "**not met**", "**missing**"
COMMAND = "python -m tools.bench"


@dataclass(frozen=True)
class Must:
    """A limit that a measured value must meet: value <= bound, or value >= bound."""

    relation: Literal["<=", ">="]
    bound: float

    def met(self, value: float) -> bool:
        """Return whether the value meets the limit; False for NaN."""
        return value <= self.bound if self.relation == "<=" else value >= self.bound

    def shown(self, unit: str) -> str:
        """Return the limit as text, for example "≤ 45 ms"."""
        sign = {"<=": "≤", ">=": "≥"}[self.relation]
        bound = number(self.bound) if float(self.bound).is_integer() else f"{self.bound:g}"
        # The unit in "2 of 9" belongs to the count only.
        return f"{sign} {_with_unit(bound, '' if unit.startswith('of ') else unit)}"


@dataclass(frozen=True)
class Row:
    """One measured value, shown in one cell of the table of a section.

    name: label of the line in the table; rows with the same name share a line.
    value: measured value in `unit`; None if there is no value.
    column: heading of the column in the table.
    must: limit that the value must meet.
    low, high: smallest and largest value of repeated measurements.
    note: remark, or the reason for a missing value.
    lead: stricter limit, which is a goal.
    ffts_column: column with the same time in units of one FFT.
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
        """Whether the value meets the limit; None without a limit or a value."""
        if self.must is None or self.value is None:
            return None
        return self.must.met(self.value)

    def shown(self) -> str:
        """Return value, range and unit as text; the unit is omitted if the column states it."""
        if self.value is None:
            return self.note or "-"
        unit = "" if self.unit in self.column.split() else self.unit
        value = _with_unit(number(self.value), unit)
        if self.low is None or self.high is None:
            return value
        return f"{value} ({number(self.low)} to {number(self.high)})"


def line(
    name: str,
    values: Mapping[str, float | None],
    unit: str = "",
    must: Must | None = None,
    lead: Must | None = None,
    note: str = "",
) -> list[Row]:
    """Return one row for each entry of `values`, which maps columns to values.

    Only the first row gets `must`, `lead` and `note`.
    """
    rows = [Row(name, value, unit, column) for column, value in values.items()]
    rows[0] = replace(rows[0], must=must, lead=lead, note=note)
    return rows


@dataclass(frozen=True)
class Missing:
    """A row that could not be measured.

    name: label of the row.
    reason: why the value is missing.
    command: shell command that makes the measurement possible.
    """

    name: str
    reason: str
    command: str

    def __str__(self) -> str:
        return f"{self.name}: {self.reason}; to enable it: {self.command}"


@dataclass(frozen=True)
class Section:
    """One section of the report: a title, an explanation and a table of rows.

    missing: rows that could not be measured.
    series: single measurements by name, from which pictures are drawn.
    footnote: text below the table.
    """

    title: str
    explanation: str
    rows: tuple[Row, ...]
    missing: tuple[Missing, ...] = ()
    series: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    footnote: str = ""


@dataclass(frozen=True)
class BenchReport:
    """The results of one run of the benchmarks.

    date: start of the run, UTC, ISO 8601.
    quick: whether less material was measured.
    duration_s: wall time of the run.
    """

    date: str
    quick: bool
    duration_s: float
    machine: MachineFacts
    sections: tuple[Section, ...]

    @property
    def missing(self) -> tuple[Missing, ...]:
        """All rows that could not be measured."""
        return tuple(missing for section in self.sections for missing in section.missing)

    @property
    def not_met(self) -> tuple[tuple[str, Row], ...]:
        """Name and row for each row that does not meet its limit."""
        return tuple(
            (_full_name(section, row), row)
            for section in self.sections
            for row in section.rows
            if row.met is False
        )

    @property
    def met_in_ffts(self) -> frozenset[str]:
        """Names of rows that miss a time limit, while the same time in FFTs meets its limit."""
        return frozenset(
            _full_name(section, row)
            for section in self.sections
            for row in section.rows
            if row.met is False
            and any(
                other.met and (other.name, other.column) == (row.name, row.ffts_column)
                for other in section.rows
            )
        )

    @property
    def met_count(self) -> int:
        """Number of rows that meet their limit."""
        return sum(row.met is True for section in self.sections for row in section.rows)

    def section(self, title: str) -> Section:
        """Return the section with this title. KeyError: there is no such section."""
        return {section.title: section for section in self.sections}[title]

    def to_json(self) -> dict[str, Any]:
        """Return the report as a JSON document, with None for infinity and NaN."""
        sections = [asdict(section) for section in self.sections]
        for shown, section in zip(sections, self.sections, strict=True):
            for row, measured in zip(shown["rows"], section.rows, strict=True):
                row["met"] = measured.met
        not_met = [name for name, _ in self.not_met]
        finite: dict[str, Any] = _finite(
            {
                "schema": SCHEMA_VERSION,
                "date": self.date,
                "quick": self.quick,
                "duration_s": self.duration_s,
                "machine": asdict(self.machine),
                "must": {
                    "met": self.met_count,
                    "not_met": not_met,
                    "met_in_ffts": [name for name in not_met if name in self.met_in_ffts],
                },
                "sections": sections,
            }
        )
        return finite

    def to_markdown(self, pictures: Mapping[str, str] | None = None) -> str:
        """Return the report as a Markdown document.

        pictures: Markdown of each picture, by the title of its section.
        """
        shown = pictures or {}
        sections = (section_markdown(each, shown.get(each.title, "")) for each in self.sections)
        return "\n".join([self._header(), *sections])

    def _header(self) -> str:
        command = f"{COMMAND} --quick" if self.quick else COMMAND
        size = "the quick run" if self.quick else "the full run"
        machine = self.machine
        lines = [
            "# Speed and error, measured",
            "",
            f"`{command} --out FILE` writes this page. The command measures or computes all "
            "values, except those of *Live bursts*, *Live latency* and the three sections with "
            "*Soak*. Other commands measure these values.",
            "",
            f"- **Run**: {self.date}, {size}, {self.duration_s:.0f} s.",
            f"- **Machine**: {machine.cpu}, {machine.cores} cores, {machine.system}, "
            f"load {machine.load_before:.1f} before the run.",
            f"- **Software**: Python {machine.python}, NumPy {machine.numpy}, "
            f"SciPy {machine.scipy}.",
            "- **Cost** is CPU time of the working thread, in ms for each second of 48 kHz "
            "stereo sound. The table shows the median of all repeats, with the smallest and the "
            "largest value in brackets.",
            "- **FFTs** are the same cost, divided by the cost of one `scipy.fft.rfft` of 2048 "
            f"float32 samples ({machine.rfft_us:.1f} µs on this machine). This FFT is timed "
            "alternately with the measured work. Costs in FFTs are comparable between machines, so "
            "costs also have limits in FFTs. These are the limits in ms, converted for a machine "
            f"whose FFT takes {1e6 * LIMITS_RFFT_S:g} µs.",
            "- **live** is the live form of the transform; **reference** is the reference form, "
            "which follows the paper's equations exactly. The column *must* shows the limit that "
            "a value should meet; the column *lead* shows a stricter limit.",
            f"- **Result**: {self._result()}",
            *(f"  - not measured: {missing}" for missing in self.missing),
            "",
        ]
        return "\n".join(lines)

    def _result(self) -> str:
        slow = [(name, row) for name, row in self.not_met if name in self.met_in_ffts]
        faults = [(name, row) for name, row in self.not_met if name not in self.met_in_ffts]
        count = f"{self.met_count} of {self.met_count + len(self.not_met)} limits met"
        if slow:
            pass_ = "1 passes" if len(slow) == 1 else f"{len(slow)} pass"
            count += f"; of the other {len(self.not_met)}, {pass_} in FFTs"
        lines = [f"{count}.", *(f"  - not met: {name}, {_verdict(row)}" for name, row in faults)]
        lines += [f"  - not met in ms, met in FFTs: {name}, {_verdict(row)}" for name, row in slow]
        return "\n".join(lines)


def number(value: float) -> str:
    """Return a number as short text, usually with three significant digits."""
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
    rounded = float(f"{value:.3g}")  # 9.996 becomes 10.0, which needs one decimal fewer
    return f"{rounded:.{max(0, 2 - math.floor(math.log10(abs(rounded))))}f}"


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}" if unit else text


def _full_name(section: Section, row: Row) -> str:
    return f"{section.title}: {row.name} ({row.column})"


def _verdict(row: Row) -> str:
    return f"{row.shown()}, must {row.must.shown(row.unit)}" if row.must else row.shown()


def section_markdown(section: Section, picture: str = "") -> str:
    """Return a section as Markdown.

    picture: Markdown of a picture to show below the explanation.
    """
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
    limits = dict.fromkeys(row.must.shown(row.unit) for row in asked if row.must)
    missed = [row.column for row in asked if not row.met]
    if not missed:
        return [", ".join(limits), MET if asked else ""]
    return [", ".join(limits), NOT_MET + (f": {'; '.join(missed)}" if len(asked) > 1 else "")]


def _lead_and_verdict(aimed: list[Row]) -> list[str]:
    limits = dict.fromkeys(row.lead.shown(row.unit) for row in aimed if row.lead)
    kept = all(row.lead.met(_plain(row.value)) for row in aimed if row.lead)
    return [", ".join(limits), "" if not aimed else MET if kept else NOT_MET]


def _plain(value: float | None) -> float:
    return math.nan if value is None else value


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |"


def _finite(item: Any) -> Any:
    if isinstance(item, float):
        return item if math.isfinite(item) else None
    if isinstance(item, dict):
        return {key: _finite(entry) for key, entry in item.items()}
    if isinstance(item, (list, tuple)):
        return [_finite(entry) for entry in item]
    return item

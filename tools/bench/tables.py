"""The report as a JSON file and a CSV file, for other programs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path

from device.atomic_file import write_bytes_atomically
from tools.bench.report import BenchReport, Section

COLUMNS = (
    "section", "row", "column", "value", "unit", "low", "high", "must", "met", "note",
)  # fmt: skip


def write_tables(report: BenchReport, stem: Path) -> list[Path]:
    """Write STEM.json and STEM.csv, and return both paths. WriteError: a file cannot be written.

    The files do not contain the series of single measurements.
    """
    document = report.to_json()
    for section in document["sections"]:
        del section["series"]
    written = {
        stem.with_suffix(".json"): json.dumps(document, indent=1) + "\n",
        stem.with_suffix(".csv"): _csv(report),
    }
    for path, text in written.items():
        write_bytes_atomically(path, text.encode())
    return [*written]


def _csv(report: BenchReport) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for section in report.sections:
        writer.writerows(csv_lines(section))
    return text.getvalue()


def csv_lines(section: Section) -> Iterator[list[str]]:
    """Yield a list of cells for each row of a section, in the order of COLUMNS."""
    for row in section.rows:
        must = row.must.shown(row.unit) if row.must else ""
        met = "" if row.met is None else "yes" if row.met else "no"
        numbers = ["" if each is None else f"{each:.6g}" for each in (row.value, row.low, row.high)]
        yield [
            section.title, row.name, row.column, numbers[0], row.unit, *numbers[1:], must,
            met, row.note,
        ]  # fmt: skip

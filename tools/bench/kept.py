"""Updates the sections of kept records in docs/benchmarks.md, .json and .csv.

Usage: python -m tools.bench.kept. This command does not measure, but reads files with earlier
    results: "Live bursts", "Live latency" and three soaks. Their footnotes name the programs that
    write these files.
"""

from __future__ import annotations

import csv
import io
import json
import re
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

from device.atomic_file import write_bytes_atomically
from tools.bench.report import Section, section_markdown
from tools.bench.sections import kept_records
from tools.bench.tables import COLUMNS, csv_lines
from tools.bench.workbench import Workbench
from tools.records import PROJECT_ROOT

STEM = PROJECT_ROOT / "docs/benchmarks"
SECTIONS = (
    kept_records.live_bursts,
    kept_records.live_latency,
    kept_records.transform_soak,
    kept_records.rig_soak,
    kept_records.identification_soak,
)


def main() -> int:
    """Replace these sections; return exit code 0, or 2 if results are missing."""
    nothing = cast(Workbench, None)  # these sections measure nothing themselves
    for measure in SECTIONS:
        section = measure(nothing)
        if section.missing:
            print(f"kept: error: {section.missing[0]}", file=sys.stderr)
            return 2
        replace_section(STEM, section)
    print(f"{STEM}.md, .json and .csv written; `python -m tools.docs --write` comes next")
    return 0


def replace_section(stem: Path, section: Section) -> None:
    """Write a section into STEM.md, STEM.json and STEM.csv.

    It replaces the section with the same title. If no section has the same title, the new one is
    inserted before "Live latency".
    """
    page = stem.with_suffix(".md").read_text()
    shown = section_markdown(section).rstrip() + "\n\n"
    found = re.search(rf"^## {re.escape(section.title)}\n.*?(?=^## |\Z)", page, re.M | re.S)
    start, end = found.span() if found else (page.index("## Live latency\n"),) * 2
    document = json.loads(stem.with_suffix(".json").read_text())
    new: dict[str, Any] = asdict(section)
    del new["series"]
    for row, measured in zip(new["rows"], section.rows, strict=True):
        row["met"] = measured.met
    titles = [each["title"] for each in document["sections"]]
    place = titles.index(section.title if section.title in titles else "Live latency")
    document["sections"][place : place + (section.title in titles)] = [new]
    lines = list(csv.reader(io.StringIO(stem.with_suffix(".csv").read_text())))
    first = next(
        number
        for number, line in enumerate(lines)
        if line[0] == (section.title if section.title in titles else "Live latency")
    )
    kept = [line for line in lines if line[0] != section.title]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [*kept[:first], *csv_lines(section), *kept[first:]]
    )
    assert lines[0] == list(COLUMNS)
    for suffix, content in (
        (".md", (page[:start] + shown + page[end:]).rstrip() + "\n"),
        (".json", json.dumps(document, indent=1) + "\n"),
        (".csv", text.getvalue()),
    ):
        write_bytes_atomically(stem.with_suffix(suffix), content.encode())


if __name__ == "__main__":
    sys.exit(main())

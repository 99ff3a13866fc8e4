"""Check or write the generated parts of the docs: `python -m tools.docs [--write]`."""

import argparse
import sys
from difflib import unified_diff
from pathlib import Path

from tools.docs.api import api_reference
from tools.docs.commands import commands_reference
from tools.docs.errors import errors_list
from tools.docs.figures import SENTENCES, Benchmarks, corrected, figures
from tools.docs.results import exports_table, results_tables
from tools.docs.tables import keys_tables, status_table
from tools.guards import guards_table

ROOT = Path(__file__).resolve().parents[2]
BEGIN = "<!-- from here: written by python -m tools.docs --write -->\n"
END = "<!-- to here -->\n"
GENERATED = {
    "docs/api.md": api_reference,
    "docs/commands.md": commands_reference,
    "docs/config.md": keys_tables,
    "docs/contributing.md": guards_table,
    "docs/errors.md": errors_list,
    "docs/exports.md": exports_table,
    "docs/figures.md": status_table,
    "docs/results.md": results_tables,
}


def as_it_should_be(name: str) -> str:
    """Return the text of a page with its generated part and the benchmarks' figures up to date."""
    page = (ROOT / name).read_text()
    if name in GENERATED:
        before, begin, rest = page.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not begin or not end:
            raise ValueError(f"{name} lacks the marks {BEGIN!r} and {END!r}")
        page = f"{before}{BEGIN}\n{GENERATED[name]()}\n{END}{after}"
    return corrected(name, page, SENTENCES.get(name, ()), figures(Benchmarks()))


def outdated() -> dict[str, str]:
    """Return the outdated pages by name, each with its difference from the correct text."""
    found = {}
    for name in sorted({*GENERATED, *SENTENCES}):
        now, wanted = (ROOT / name).read_text(), as_it_should_be(name)
        if now != wanted:
            lines = unified_diff(
                now.splitlines(), wanted.splitlines(), name, name, n=0, lineterm=""
            )
            found[name] = "\n".join(lines)
    return found


def main() -> int:
    """Write the outdated pages, or print the differences. Return 1 if a page remains outdated."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the pages")
    write = parser.parse_args().write
    found = outdated()
    for name, change in found.items():
        if write:
            (ROOT / name).write_text(as_it_should_be(name))
        print(f"{name} written" if write else change)
    return 0 if write else bool(found)


if __name__ == "__main__":
    sys.exit(main())

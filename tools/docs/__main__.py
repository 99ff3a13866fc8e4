"""Check the generated parts of docs/, or write them: `python -m tools.docs [--write]`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tools.docs.api import api_reference
from tools.docs.commands import commands_reference
from tools.docs.errors import errors_list
from tools.docs.keys import keys_tables
from tools.docs.results import results_tables

DOCS = Path(__file__).resolve().parents[2] / "docs"
BEGIN = "<!-- from here: written by python -m tools.docs --write -->\n"
END = "<!-- to here -->\n"
GENERATED = {
    "api.md": api_reference,
    "commands.md": commands_reference,
    "config.md": keys_tables,
    "errors.md": errors_list,
    "results.md": results_tables,
}
"""Page: the function that returns its generated part."""


def with_generated(name: str) -> str:
    """Return a page of docs/ with what its generated part should be now."""
    page = (DOCS / name).read_text()
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"docs/{name} lacks the marks {BEGIN!r} and {END!r}")
    return f"{before}{BEGIN}\n{GENERATED[name]()}\n{END}{after}"


def outdated() -> list[str]:
    """Return the pages whose generated part is not what it should be."""
    return [name for name in GENERATED if (DOCS / name).read_text() != with_generated(name)]


def main() -> int:
    """Write the outdated pages, or name them; exit code 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the pages")
    write = parser.parse_args().write
    names = outdated()
    for name in names:
        if write:
            (DOCS / name).write_text(with_generated(name))
        print(f"docs/{name} {'written' if write else 'is outdated'}")
    return 0 if write else bool(names)


if __name__ == "__main__":
    sys.exit(main())

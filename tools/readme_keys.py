"""Print the table of config keys, or write it: `python -m tools.readme_keys --write`."""

from __future__ import annotations

import argparse
from itertools import groupby
from pathlib import Path

from audioflinger_hook.config.schema import CHANGES, HEADERS, KEYS, Key

README = Path(__file__).resolve().parents[1] / "README.md"
BEGIN = "<!-- keys: written by python -m tools.readme_keys --write -->\n"
END = "<!-- end of keys -->\n"


def keys_table() -> str:
    """Return every key of the config with what is allowed, default, option, meaning and change."""
    parts = []
    for section, keys in groupby(KEYS, key=lambda key: key.section):
        heading = f"In `{HEADERS[section]}`:" if section else "Top-level keys:"
        lines = ["| key | allowed | default | option | meaning | a change while it runs |"]
        lines += ["| --- | --- | --- | --- | --- | --- |", *map(_row, keys)]
        parts.append("\n".join([heading, "", *lines]))
    return "\n\n".join(parts) + "\n"


def with_table(page: str) -> str:
    """Return a page with the table between its two marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{keys_table()}\n{END}{after}"


def _row(key: Key) -> str:
    flag = f"`{key.flag}`" if key.flag else ""
    default = f"`{key.shown_default}`" if key.shown_default else ""
    default = default.replace(" in run, else ", "` in `run`, else `")
    described = key.description
    cells = (f"`{key.name}`", described.allowed, default, flag, described.meaning)
    shown = [cell.replace("|", "\\|") for cell in (*cells, CHANGES[key.change])]
    return f"| {' | '.join(shown)} |"


def main() -> None:
    """Print the table, or write README.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write README.md")
    if parser.parse_args().write:
        README.write_text(with_table(README.read_text()))
    else:
        print(keys_table(), end="")


if __name__ == "__main__":
    main()

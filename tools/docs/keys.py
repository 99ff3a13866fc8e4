"""The tables of config keys in docs/config.md, from the schema."""

from __future__ import annotations

from itertools import groupby

from audioflinger_hook.config.schema import CHANGES, HEADERS, KEYS, Key


def keys_tables() -> str:
    """Return every key of the config with what is allowed, default, option, meaning and change."""
    parts = []
    for section, keys in groupby(KEYS, key=lambda key: key.section):
        heading = f"In `{HEADERS[section]}`:" if section else "Top-level keys:"
        lines = ["| key | allowed | default | option | meaning | a change while it runs |"]
        lines += ["| --- | --- | --- | --- | --- | --- |", *map(_row, keys)]
        parts.append("\n".join([heading, "", *lines]))
    return "\n\n".join(parts) + "\n"


def _row(key: Key) -> str:
    flag = f"`{key.flag}`" if key.flag else ""
    default = f"`{key.shown_default}`" if key.shown_default else ""
    default = default.replace(" in run, else ", "` in `run`, else `")
    described = key.description
    cells = (f"`{key.name}`", described.allowed, default, flag, described.meaning)
    shown = [cell.replace("|", "\\|") for cell in (*cells, CHANGES[key.change])]
    return f"| {' | '.join(shown)} |"

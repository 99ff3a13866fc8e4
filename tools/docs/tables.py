"""Generates the tables in docs/config.md (config keys) and docs/figures.md (daemon's figures)."""

from itertools import groupby

from audioflinger_hook.config.schema import CHANGES, HEADERS, KEYS, Key
from audioflinger_hook.service.figure import Entry, entries
from audioflinger_hook.service.status import Status


def keys_tables() -> str:
    """Return a table of all config keys, with allowed values, default, option and meaning."""
    parts = []
    for section, keys in groupby(KEYS, key=lambda key: key.section):
        heading = f"In `{HEADERS[section]}`:" if section else "Top-level keys:"
        lines = ["| key | allowed | default | option | meaning | a change while it runs |"]
        lines += ["| --- | --- | --- | --- | --- | --- |", *map(_key_row, keys)]
        parts.append("\n".join([heading, "", *lines]))
    return "\n\n".join(parts) + "\n"


def _key_row(key: Key) -> str:
    flag = f"`{key.flag}`" if key.flag else ""
    default = f"`{key.shown_default}`" if key.shown_default else ""
    default = default.replace(" in run, else ", "` in `run`, else `")
    described = key.description
    cells = (f"`{key.name}`", described.allowed, default, flag, described.meaning)
    shown = [cell.replace("|", "\\|") for cell in (*cells, CHANGES[key.change])]
    return f"| {' | '.join(shown)} |"


def status_table() -> str:
    """Return a table of the daemon's figures: JSON key, unit, kind, meaning and metric."""
    lines = ["| key | unit | kind | meaning | metric |", "| --- | --- | --- | --- | --- |"]
    return "\n".join([*lines, *map(_figure_row, entries(Status))]) + "\n"


def _figure_row(entry: Entry) -> str:
    in_list = any(name.endswith("[]") for name in entry.path[:-1])
    name, bracket, label = ("" if in_list else entry.figure.metric).partition("{")
    name += "_total" if name and entry.kind == "count" else ""
    metric = f"`{name}{bracket}{label.lstrip('^')}`" if name else ""
    shown = f"`{'.'.join(entry.path)}`", entry.unit, entry.kind, entry.figure.help, metric
    return f"| {' | '.join(shown)} |"

"""The table of figures in docs/figures.md, from the status of the daemon."""

from __future__ import annotations

from audioflinger_hook.service.figure import Entry, entries
from audioflinger_hook.service.status import Status


def status_table() -> str:
    """Return every figure with its key in JSON, unit, kind, meaning and metric of Prometheus."""
    lines = ["| key | unit | kind | meaning | metric |", "| --- | --- | --- | --- | --- |"]
    return "\n".join([*lines, *map(_row, entries(Status))]) + "\n"


def _row(entry: Entry) -> str:
    in_list = any(name.endswith("[]") for name in entry.path[:-1])
    name, bracket, label = ("" if in_list else entry.figure.metric).partition("{")
    name += "_total" if name and entry.kind == "count" else ""
    metric = f"`{name}{bracket}{label.lstrip('^')}`" if name else ""
    shown = f"`{'.'.join(entry.path)}`", entry.unit, entry.kind, entry.figure.help, metric
    return f"| {' | '.join(shown)} |"

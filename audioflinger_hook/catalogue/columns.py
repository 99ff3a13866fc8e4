"""The columns of a manifest: our names, those of NeMo and lhotse, and names that are misspelled."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from audioflinger_hook.catalogue.item import Item, shown, typed
from device.values import nearest

ALIASES = {
    "audio_filepath": "audio",  # NeMo
    "offset": "start_s",
    "start": "start_s",  # lhotse
    "duration": "duration_s",
    "channel": "channels",
}
"""Names of NeMo and lhotse, and ours."""

_SIMILAR = ("audio", "start_s", "duration_s", "channels", "profile", "language", "audio_filepath")


def values_of(row: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return a row's values by our names, and its mistakes: contradictions and misspelled names."""
    values: dict[str, Any] = {}
    mistakes = []
    for name, value in _from_lhotse(row).items():
        ours = ALIASES.get(name, name)
        if ours in Item.NAMES:
            if ours not in values:
                values[ours] = value
            elif values[ours] != value:
                both = f"{shown(values[ours])} and {shown(value)}"
                mistakes.append(f"{ours} is given twice, as {both}; leave one out")
        elif guess := _meant(name):
            mistakes.append(f"{shown(name)} is not known; did you mean {guess}?")
    return values if mistakes else typed(values), mistakes


def cell_value(name: str, cell: str) -> Any:
    """Return the value of a cell of CSV, a number where the column has numbers."""
    ours = ALIASES.get(name, name)
    try:
        if ours == "track":
            return int(cell)
        if ours in Item.NUMBERS:
            return float(cell)
        if ours == "channels" and cell not in ("mono", "each"):
            return [int(one) for one in cell.split()]
    except ValueError:
        pass
    return cell


@lru_cache(maxsize=1024)
def _meant(name: str) -> str:
    """Return the known name that differs so little that it is meant, "" for another column."""
    known = nearest(name, _SIMILAR)
    return known if known and _differ_little(name, known) else ""


def _differ_little(name: str, known: str) -> bool:
    plain = name.lower().replace("-", "_").strip()
    return plain in (known, f"{known}s", known.removesuffix("s"), known.removesuffix("_s")) or (
        abs(len(name) - len(known)) <= 1
        and sum(a != b for a, b in zip(plain, known, strict=False)) <= 2
    )


def _from_lhotse(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row with the audio of a lhotse recording or cut, if it is one."""
    recording = row.get("recording", row)
    sources = recording.get("sources") if isinstance(recording, dict) else None
    if not isinstance(sources, list) or len(sources) != 1 or not isinstance(sources[0], dict):
        return row
    source = sources[0]
    if source.get("type") not in ("file", "url"):
        return row
    return {**row, "audio": source.get("source")}

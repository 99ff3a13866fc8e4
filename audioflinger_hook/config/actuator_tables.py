"""The tables [[actuator]] of a config file: every mistake in them, and what they mean.

Keys are told as `actuator[1].gain_db`; tables count from 1, as lines do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from audioflinger_hook.config.settings import wrong_rig
from audioflinger_hook.transform.parameters import Problem
from device.drive import ActuatorSettings, problems_together
from device.drive import problems as problems_of_one
from device.drive.settings import KEYS
from device.rig.rig_file import SHIPPED

ACTUATOR = "actuator"
HEADER = f"[[{ACTUATOR}]]"

Table = Mapping[str, Any]


def tables_of(document: Table) -> list[Table]:
    """Return the tables of a document, none where it has something else instead."""
    tables = document.get(ACTUATOR, [])
    if not isinstance(tables, list):
        return []
    return [table for table in tables if isinstance(table, dict)]


def are_no_tables(document: Table) -> bool:
    """Return whether a document has something of the name that is no array of tables."""
    if ACTUATOR not in document:
        return False
    tables = tables_of(document)
    return not tables or len(tables) != len(document[ACTUATOR])


def values_of(tables: Sequence[Table]) -> dict[str, Any]:
    """Return every value by the key that messages show."""
    return {
        f"{ACTUATOR}[{number}].{key}": value
        for number, table in enumerate(tables, 1)
        for key, value in table.items()
    }


def unknown_of(tables: Sequence[Table]) -> dict[str, Any]:
    """Return the values of keys that do not exist, by the key that messages show."""
    values = values_of(tables)
    return {key: values[key] for key in values if key.partition(".")[2] not in KEYS}


def problems(tables: Sequence[Table], folder: Path) -> dict[str, Problem]:
    """Return what is wrong, by the key that messages show. folder: where rigs' files are."""
    found: dict[str, Problem] = {}
    wired: list[tuple[int | str, ...]] = []
    for number, table in enumerate(tables, 1):
        wrong = {name: Problem(*problem) for name, problem in problems_of_one(table).items()}
        if "rig" in table and (wrong_one := wrong_rig(table["rig"], folder)):
            wrong["rig"] = wrong_one
        wired.append(() if "channels" in wrong else tuple(table["channels"]))
        found |= {f"{ACTUATOR}[{number}].{name}": problem for name, problem in wrong.items()}
    for number, problem in problems_together(wired).items():
        # Channels that cannot be used at all were told of.
        found.setdefault(f"{ACTUATOR}[{number}].channels", Problem(*problem))
    return found


def from_tables(tables: Sequence[Table], folder: Path) -> tuple[ActuatorSettings, ...]:
    """Return the actuators that the tables mean; `problems` has found nothing wrong."""
    actuators = []
    for table in tables:
        rig = table.get("rig")
        named = {} if rig is None or rig in SHIPPED else {"rig": str(folder / rig)}
        actuators.append(ActuatorSettings.from_document({**table, **named}))
    return tuple(actuators)

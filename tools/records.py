"""Files of measured results (records) for the benchmark report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import audioflinger_hook
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")

PROJECT_ROOT = Path(str(audioflinger_hook.__path__[0])).resolve().parent
SCHEMA_VERSION = 1

KINDS: Mapping[str, tuple[type, ...]] = {
    "str": (str,),
    "bool": (bool,),
    "int": (int,),
    "float": (int, float),
    "Numbers": (list, tuple),
}


def typed(record: Record) -> Record:
    """Return the record. TypeError: a field does not have its annotated type."""
    for field in fields(record):
        value = getattr(record, field.name)
        name = str(field.type)
        if value is None and name.endswith(" | None"):
            continue
        allowed = KINDS[name.removesuffix(" | None")]
        if not _is_one(value, allowed):
            raise TypeError(f"{field.name} is {value!r}, not {name}")
        if allowed is KINDS["Numbers"]:
            for entry in value:
                if entry is not None and not _is_one(entry, KINDS["float"]):
                    raise TypeError(f"{field.name} holds {entry!r}, not numbers")
    return record


def _is_one(value: Any, kinds: tuple[type, ...]) -> bool:
    return isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool))


def now() -> str:
    """Return the current UTC time as text (ISO 8601), to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def record_path(record: Path) -> Path:
    """Return `record` itself if this file exists, else its path in the project's folder."""
    return record if record.is_file() else PROJECT_ROOT / record


def read_records(path: Path, kind: type[Record], command: str) -> tuple[Record, ...]:
    """Return the records of a file; empty if there is no file.

    UsageError: the file has no valid records; the message names the command that writes them.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return tuple(typed(kind(**record)) for record in document["records"])
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UsageError(f"{path} has no valid records ({error}); `{command}` writes it") from None


def write_records(records: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write a file of records atomically."""
    document = {"schema": SCHEMA_VERSION, "records": list(records)}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes_atomically(path, (json.dumps(document, indent=1) + "\n").encode())


def merged(
    read: Callable[[Path], tuple[Record, ...]],
    path: Path,
    records: Iterable[Record],
    name: Callable[[Record], str],
) -> dict[str, Record]:
    """Return the file's records by name, updated with new records."""
    try:
        kept = {name(record): record for record in read(path)}
    except UsageError:
        kept = {}  # an unreadable file is replaced
    return kept | {name(record): record for record in records}

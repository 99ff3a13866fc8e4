"""What a soak leaves behind: its record in docs/soak.json, for the report to show.

A document {"schema": 1, "records": [{SoakRecord}, ...]}, one record a run, the latest of each name.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from device.atomic_file import write_bytes_atomically
from device.errors import UsageError
from tools.bench.sounds.signals import PROJECT_ROOT
from tools.records import typed

SCHEMA_VERSION = 1
RECORD = Path("docs/soak.json")
COMMAND = "make soak"


@dataclass(frozen=True)
class SoakRecord:
    """What one soak run found.

    what: its name; date: UTC, ISO 8601; stream_s: how long the stream was; took_s: CPU time;
    passed: whether every limit was kept. None where the run does not measure it:

    hops; memory_growth_kb, objects_left: what the process holds more at its end; level_drift_db,
    thdn_start_db, thdn_end_db: a steady tone at its end against its start.
    samples; energy_creep: by which share the largest energy of any loop of a steady drive is off
    from that of the first; energy_rise: the largest rise from step to step once the drive has
    stopped; energy_from_nowhere: of a step; both as shares of the energy.
    rigs; f0_error_percent, q_error_percent: the largest; f0_held_percent, q_held_percent: of the
    rigs whose interval of 95 % held the truth.
    """

    what: str
    date: str
    cpu: str
    stream_s: float
    took_s: float
    passed: bool
    hops: int | None = None
    memory_growth_kb: float | None = None
    objects_left: int | None = None
    level_drift_db: float | None = None
    thdn_start_db: float | None = None
    thdn_end_db: float | None = None
    samples: int | None = None
    energy_creep: float | None = None
    energy_rise: float | None = None
    energy_from_nowhere: float | None = None
    rigs: int | None = None
    f0_error_percent: float | None = None
    q_error_percent: float | None = None
    f0_held_percent: float | None = None
    q_held_percent: float | None = None


def now() -> str:
    """Return the time in UTC to the second, ISO 8601."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def record_path() -> Path:
    """Return where the record is: below the current folder if it is there, else the project's."""
    return RECORD if RECORD.is_file() else PROJECT_ROOT / RECORD


def read_records(path: Path) -> tuple[SoakRecord, ...]:
    """Return the records of a file, none where there is no file.

    Raises
    ------
    UsageError
        The file is there but is no soak record.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return tuple(typed(SoakRecord(**record)) for record in document["records"])
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UsageError(f"{path} is no soak record ({error}); {COMMAND} writes it anew") from None


def keep_record(record: SoakRecord, path: Path) -> None:
    """Put a record into the file, in place of the one of its name; whole or not at all."""
    try:
        records = {kept.what: kept for kept in read_records(path)}
    except UsageError:
        records = {}  # what cannot be read is replaced
    records[record.what] = record
    document = {
        "schema": SCHEMA_VERSION,
        "records": [_measured(records[what]) for what in sorted(records)],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes_atomically(path, (json.dumps(document, indent=1) + "\n").encode())


def _measured(record: SoakRecord) -> dict[str, object]:
    return {name: value for name, value in asdict(record).items() if value is not None}

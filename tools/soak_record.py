"""The record and the limits of the soaks, which `make soak` runs and keeps in docs/soak.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from tools import records
from tools.bench.report import Must

RECORD = Path("docs/soak.json")
COMMAND = "make soak"

HOPS = 1_000_000
SAMPLES = 100_000_000
"""Of each of the rig's models."""
NO_GROWTH_KB, NO_GROWTH_OBJECTS = Must("<=", 256.0), Must("<=", 200)
NO_DRIFT_DB, PURITY = Must("<=", 0.01), Must("<=", -60.0)
NO_CREEP = Must("<=", 1e-6)
PASSIVE = Must("<=", 1e-6)
"""Rise of the energy in a step, as a share of it."""
RIGS = 200
"""Rigs that are identified at each sweep level."""
SNR_DB = 20.0
F0_ERROR, Q_ERROR = Must("<=", 0.5), Must("<=", 5.0)
HELD = Must(">=", 90.0)
"""Per cent, of intervals of 95 %."""


@dataclass(frozen=True)
class SoakRecord:
    """What one soak run found; None where it does not measure it.

    stream_s: length of the stream; took_s: CPU time. energy_creep: largest change of a loop's peak
    energy; energy_rise: largest rise from step to step after the drive; both as shares of it.
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
    rigs: int | None = None
    f0_error_percent: float | None = None
    q_error_percent: float | None = None
    f0_held_percent: float | None = None
    q_held_percent: float | None = None


def read_records(path: Path) -> tuple[SoakRecord, ...]:
    """Return the records of a file; raises as `records.read_records`."""
    return records.read_records(path, SoakRecord, COMMAND)


def keep_record(record: SoakRecord, path: Path) -> None:
    """Put a record into the file, in place of the one of its name; all or nothing."""
    kept = records.merged(read_records, path, [record], lambda each: each.what)
    ordered = (asdict(kept[what]) for what in sorted(kept))
    records.write_records(
        ({name: value for name, value in each.items() if value is not None} for each in ordered),
        path,
    )

"""Pass criteria of the long-run tests of `make soak`, and results (records) in docs/soak.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from tools import records
from tools.bench.report import Must

RECORD = Path("docs/soak.json")
COMMAND = "make soak"

HOPS = 1_000_000
SAMPLES = 100_000_000  # samples for each model of the rig
NO_GROWTH_KB, NO_GROWTH_OBJECTS = Must("<=", 256.0), Must("<=", 200)
NO_DRIFT_DB, PURITY = Must("<=", 0.01), Must("<=", -60.0)
NO_CREEP = Must("<=", 1e-6)
PASSIVE = Must("<=", 1e-6)
"""Largest rise of the stored energy in a step without drive, relative to the stored energy."""
RIGS = 200  # number of rigs that are identified at each sweep level
SNR_DB = 20.0
F0_ERROR, Q_ERROR = Must("<=", 0.5), Must("<=", 5.0)
HELD = Must(">=", 90.0)  # percentage of 95 % intervals that contain the true value


@dataclass(frozen=True)
class SoakRecord:
    """Results of one long-run test; a value that the test does not measure is None.

    stream_s: duration of the sound or of the drive signal. took_s: CPU time in s.
    energy_creep: largest relative change of the peak of the rig's energy, from the first measured
        repetition of the drive signal to a later one.
    energy_rise: largest relative rise of the rig's energy from sample to sample after the end of
        the drive signal.
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
    """Return the records in a file. Errors: as for `records.read_records`."""
    return records.read_records(path, SoakRecord, COMMAND)


def keep_record(record: SoakRecord, path: Path) -> None:
    """Write a record to the file atomically, in place of a record of the same test."""
    kept = records.merged(read_records, path, [record], lambda each: each.what)
    ordered = (asdict(kept[what]) for what in sorted(kept))
    records.write_records(
        ({name: value for name, value in each.items() if value is not None} for each in ordered),
        path,
    )

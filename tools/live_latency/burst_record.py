"""The record of how late bursts are felt, kept in docs/bursts.json by tools/burst_latency.py."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tools import records

RECORD = Path("docs/bursts.json")
COMMAND = "python tools/burst_latency.py --rate 48000 44100 --out docs/bursts.json"


@dataclass(frozen=True)
class BurstRecord:
    """One measurement; delays in ms to a tenth and to half of the vibration's peak.

    tap: what is tapped, "streams" or "monitor". quantum_frames, rate_hz: of the graph. bursts: how
    many were measured. budget_ms: the delay that the daemon's status shows.
    """

    server: str
    engine: str
    tap: str
    quantum_frames: int
    rate_hz: int
    date: str
    bursts: int
    tenth_median_ms: float
    tenth_p95_ms: float
    half_median_ms: float
    half_p95_ms: float
    budget_ms: float

    @property
    def name(self) -> str:
        """What was measured, the same for the next measurement."""
        return (
            f"{self.server}, {self.engine}, {self.tap}, {self.quantum_frames} frames at "
            f"{self.rate_hz} Hz"
        )

    @property
    def told(self) -> str:
        """The record for a person to read."""
        return (
            f"{self.name}: to half of the peak {self.half_median_ms:.1f} ms (95 % under "
            f"{self.half_p95_ms:.1f}), to a tenth {self.tenth_median_ms:.1f} ms (95 % under "
            f"{self.tenth_p95_ms:.1f}); the daemon says {self.budget_ms:.1f} ms; "
            f"{self.bursts} bursts"
        )


def to_json(measured: Iterable[BurstRecord]) -> dict[str, Any]:
    """Return the document, numbers to two digits after the point."""
    found = [
        {key: round(one, 2) if isinstance(one, float) else one for key, one in asdict(each).items()}
        for each in measured
    ]
    return {"schema": records.SCHEMA_VERSION, "records": found}


def read_records(path: Path) -> tuple[BurstRecord, ...]:
    """Return the records of a file; raises as `records.read_records`."""
    return records.read_records(path, BurstRecord, COMMAND)


def keep_records(measured: Iterable[BurstRecord], path: Path) -> None:
    """Put records into the file, each in place of the one of its name; all or nothing."""
    kept = records.merged(read_records, path, measured, lambda record: record.name)
    records.write_records(to_json(kept[name] for name in sorted(kept))["records"], path)

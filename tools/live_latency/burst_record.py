"""Results of burst measurements, which tools/burst_latency.py stores in docs/bursts.json."""

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
    """Delays in ms from bursts until their vibration reaches a tenth, and half, of its peak.

    tap: where the daemon records the sound, "streams" of players or "monitor" of their sink.
    quantum_frames: cycle of PipeWire's graph in frames.
    rate_hz: sample rate of PipeWire's graph.
    bursts: number of measured bursts.
    budget_ms: delay that the daemon reports.
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
        """The measured set-up as text. New results replace stored results with the same name."""
        return (
            f"{self.server}, {self.engine}, {self.tap}, {self.quantum_frames} frames at "
            f"{self.rate_hz} Hz"
        )

    @property
    def told(self) -> str:
        """The results as one line of text."""
        return (
            f"{self.name}: to half of the peak {self.half_median_ms:.1f} ms (95 % under "
            f"{self.half_p95_ms:.1f}), to a tenth {self.tenth_median_ms:.1f} ms (95 % under "
            f"{self.tenth_p95_ms:.1f}); the daemon says {self.budget_ms:.1f} ms; "
            f"{self.bursts} bursts"
        )


def to_json(measured: Iterable[BurstRecord]) -> dict[str, Any]:
    """Return the results as a JSON document, with numbers rounded to two decimals."""
    found = [
        {key: round(one, 2) if isinstance(one, float) else one for key, one in asdict(each).items()}
        for each in measured
    ]
    return {"schema": records.SCHEMA_VERSION, "records": found}


def read_records(path: Path) -> tuple[BurstRecord, ...]:
    """Return the results in a file; errors as in `tools.records.read_records`."""
    return records.read_records(path, BurstRecord, COMMAND)


def keep_records(measured: Iterable[BurstRecord], path: Path) -> None:
    """Add results to the file. New results replace stored results with the same names."""
    kept = records.merged(read_records, path, measured, lambda record: record.name)
    records.write_records(to_json(kept[name] for name in sorted(kept))["records"], path)

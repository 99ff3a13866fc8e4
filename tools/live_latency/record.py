"""Results of latency measurements, which tools/latency.py stores in docs/live.json."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tools import records

RECORD = Path("docs/live.json")
COMMAND = "python tools/latency.py --seconds 60 --out docs/live.json"
TRUSTED_MS = 1.0  # largest delay in ms between two recordings of one monitor if results are valid

Numbers = tuple[float | None, ...]


@dataclass(frozen=True)
class LiveRecord:
    """Results of one measurement of a running daemon. A value that was not measured is None.

    engine: native or python.
    quantum_frames: requested cycle of PipeWire's graph; None for PipeWire's choice.
    lags_ms: delay of the vibration in each piece of `window_s` s, including the transform's
        latency.
    budgets_ms: the same delay as reported by the daemon.
    growth_ms: change of the delay from the start to the end, on a fitted line.
    hidden_growth_ms: part of this change that the daemon does not report.
    check_median_ms, check_worst_ms: delay between two recordings of one monitor, which shows the
        error of the measurement.
    splices: number of places in the recordings where frames are missing or inserted.
    machine_pauses: number of pauses of the whole machine.
    child_cpu_percent, child_memory_growth_kb: CPU time and memory growth of the native engine's
        process.
    """

    server: str
    block_frames: int | None
    date: str
    cpu: str
    cores: int
    load_before: float
    load_after: float
    stimulus: str
    seconds: float
    window_s: float
    lag_median_ms: float | None
    lag_p5_ms: float | None
    lag_p95_ms: float | None
    growth_ms: float | None
    hidden_growth_ms: float | None
    dropouts: int
    dropout_ms: float
    splices: int
    check_median_ms: float | None
    check_worst_ms: float | None
    budget_ms: float | None
    transform_ms: float | None
    target_ms: float | None
    delay_ms: float | None
    ratio_ppm: float | None
    resyncs: int
    underflows: int
    overflows: int
    recoveries: int
    cpu_percent: float | None
    memory_growth_kb: float | None
    lags_ms: Numbers
    budgets_ms: Numbers
    machine_pauses: int | None = None
    machine_pause_ms: float | None = None
    engine: str = "python"
    quantum_frames: int | None = None
    child_cpu_percent: float | None = None
    child_memory_growth_kb: float | None = None

    @property
    def name(self) -> str:
        """Server, engine and block sizes. New results replace stored results with the same name."""
        engine = "" if self.engine == "python" else f", {self.engine}"
        quantum = "" if self.quantum_frames is None else f", quantum {self.quantum_frames}"
        frames = "" if self.block_frames is None else f", {self.block_frames} frames"
        return f"{self.server}{engine}{quantum}{frames}"

    @property
    def busy(self) -> bool:
        """Whether the system load exceeded the number of cores, before or after the measurement."""
        return max(self.load_before, self.load_after) > self.cores

    @property
    def trusted(self) -> bool:
        """Whether the median error of the measurement is known and at most 1 ms."""
        return self.check_median_ms is not None and abs(self.check_median_ms) <= TRUSTED_MS


def to_json(measured: Iterable[LiveRecord]) -> dict[str, Any]:
    """Return the results as a JSON document, with numbers rounded to three decimals."""
    return {
        "schema": records.SCHEMA_VERSION,
        "records": [_rounded(asdict(record)) for record in measured],
    }


def _rounded(item: Any) -> Any:
    if isinstance(item, float):
        return round(item, 3) if math.isfinite(item) else None
    if isinstance(item, dict):
        return {key: _rounded(entry) for key, entry in item.items()}
    if isinstance(item, (list, tuple)):
        return [_rounded(entry) for entry in item]
    return item


def read_records(path: Path) -> tuple[LiveRecord, ...]:
    """Return the results in a file; errors as in `tools.records.read_records`."""
    return tuple(
        replace(record, lags_ms=tuple(record.lags_ms), budgets_ms=tuple(record.budgets_ms))
        for record in records.read_records(path, LiveRecord, COMMAND)
    )


def keep_records(measured: Iterable[LiveRecord], path: Path) -> None:
    """Add results to the file. New results replace stored results with the same names."""
    kept = records.merged(read_records, path, measured, lambda record: record.name)
    ordered = [kept[name] for name in sorted(kept, key=_in_order)]
    records.write_records(to_json(ordered)["records"], path)


def _in_order(name: str) -> tuple[str, tuple[int, ...]]:
    """Return a key that sorts names by their words and then by their numbers."""
    words = re.sub(r"\d+", "", name)
    return words, tuple(map(int, re.findall(r"\d+", name)))

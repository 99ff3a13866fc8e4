"""The record of a live measurement, kept in docs/live.json by tools/latency.py."""

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
TRUSTED_MS = 1.0
"""Largest trusted lag between two recordings of one monitor."""

Numbers = tuple[float | None, ...]


@dataclass(frozen=True)
class LiveRecord:
    """One measurement of a running daemon; times in ms, None where nothing was measured.

    lags_ms: of each window, the delay of the vibration after its sound, transform included;
    budgets_ms: what the daemon reported meanwhile. growth_ms: change of the lag over the run, by a
    robust line; hidden_growth_ms: the part that the daemon does not report. check_*_ms: the lag
    between two recordings of one monitor, the instrument's own error. splices: places where the
    recordings lack frames. machine_pauses: how often the whole machine stood still. engine: native
    or python; child_*: of the native engine's process. quantum_frames: cycle of PipeWire's graph
    that was asked for, None for its own choice.
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
        """Server, engine and block sizes, the same for the next measurement."""
        engine = "" if self.engine == "python" else f", {self.engine}"
        quantum = "" if self.quantum_frames is None else f", quantum {self.quantum_frames}"
        frames = "" if self.block_frames is None else f", {self.block_frames} frames"
        return f"{self.server}{engine}{quantum}{frames}"

    @property
    def busy(self) -> bool:
        """Whether the machine was overloaded."""
        return max(self.load_before, self.load_after) > self.cores

    @property
    def trusted(self) -> bool:
        """Whether the instrument's own error is small."""
        return self.check_median_ms is not None and abs(self.check_median_ms) <= TRUSTED_MS


def to_json(measured: Iterable[LiveRecord]) -> dict[str, Any]:
    """Return the document, numbers to three digits after the point."""
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
    """Return the records of a file; raises as `records.read_records`."""
    return tuple(
        replace(record, lags_ms=tuple(record.lags_ms), budgets_ms=tuple(record.budgets_ms))
        for record in records.read_records(path, LiveRecord, COMMAND)
    )


def keep_records(measured: Iterable[LiveRecord], path: Path) -> None:
    """Put records into the file, each in place of the one of its name; all or nothing."""
    kept = records.merged(read_records, path, measured, lambda record: record.name)
    ordered = [kept[name] for name in sorted(kept, key=_in_order)]
    records.write_records(to_json(ordered)["records"], path)


def _in_order(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the words and then the numbers of a name, so that 1024 frames come after 256."""
    words = re.sub(r"\d+", "", name)
    return words, tuple(map(int, re.findall(r"\d+", name)))

"""What live measurements found, kept in docs/live.json, and the table that the report shows of it.

tools/latency.py measures and writes; the document is {"schema": 1, "records": [{LiveRecord}, ...]},
the latest of each server and block size.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from audioflinger_hook.config.settings import LiveSettings
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError
from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sounds.signals import PROJECT_ROOT
from tools.bench.workbench import Workbench
from tools.records import typed

SCHEMA_VERSION = 1
RECORD = Path("docs/live.json")
COMMAND = "python tools/latency.py --seconds 60 --out docs/live.json"

USUAL_BLOCK_FRAMES = LiveSettings.block_frames
"""What the daemon's streams take at a time unless told otherwise; limits are asked of it."""

LAG = Must("<=", 90.0)
NO_GROWTH_MS = Must("<=", 1.0)
CPU_PERCENT = Must("<=", 8.0)
TRUSTED_MS = 1.0
"""The same monitor recorded twice may differ by so much; else the measurement is not one."""

Numbers = tuple[float | None, ...]


@dataclass(frozen=True)
class LiveRecord:
    """One measurement of a running daemon; times in ms, None where there was nothing to measure.

    server: name and version; block_frames: of the daemon's streams, None where not known. date:
    UTC, ISO 8601. load_before, load_after: runnable tasks, the mean of the last minute. stimulus:
    what played. seconds, window_s: how long was measured, and in what pieces.

    lags_ms: of each window, by how much the vibration comes after its sound, from monitor to
    monitor, transform included; budgets_ms: what the daemon said meanwhile. lag_*_ms: of all of
    them; growth_ms: how much later at the end than at the start, by a robust line;
    hidden_growth_ms: the same of the part that the daemon does not tell of. (It provides for late
    callbacks, and says so: on a busy machine the lag may grow by that.)

    dropouts, dropout_ms: silences amid vibration. splices: places where the recordings, not what
    they recorded, lack frames. check_median_ms, check_worst_ms: the lag between two recordings of
    the same monitor, which is the instrument's own error.

    budget_ms, transform_ms, target_ms, delay_ms, ratio_ppm: the daemon's status, medians. resyncs,
    underflows, overflows, recoveries: how often, in this time. cpu_percent: of one core, what all
    its threads used; memory_growth_kb: how much more it held at the end than at the start.
    machine_pauses, machine_pause_ms: how often the machine itself stood still, and for how long at
    worst; most resyncs and dropouts come of that where it is a virtual one. None: nobody watched.
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

    @property
    def name(self) -> str:
        """What was measured, in a few words; the same for the next measurement of it."""
        frames = "" if self.block_frames is None else f", {self.block_frames} frames"
        return f"{self.server}{frames}"

    @property
    def busy(self) -> bool:
        """Whether the machine had more to do than it has cores: lags are then its own affair."""
        return max(self.load_before, self.load_after) > self.cores

    @property
    def trusted(self) -> bool:
        """Whether the instrument found 0 where there is 0."""
        return self.check_median_ms is not None and abs(self.check_median_ms) <= TRUSTED_MS


def to_json(records: Iterable[LiveRecord]) -> dict[str, Any]:
    """Return the document; numbers to a microsecond or a millionth, those not finite as None."""
    document: dict[str, Any] = {"schema": SCHEMA_VERSION}
    document["records"] = [_rounded(asdict(record)) for record in records]
    return document


def _rounded(item: Any) -> Any:
    if isinstance(item, float):
        return round(item, 3) if math.isfinite(item) else None
    if isinstance(item, dict):
        return {key: _rounded(entry) for key, entry in item.items()}
    if isinstance(item, (list, tuple)):
        return [_rounded(entry) for entry in item]
    return item


def record_path() -> Path:
    """Return where the records are: below the current folder if they are, else the project's."""
    return RECORD if RECORD.is_file() else PROJECT_ROOT / RECORD


def read_records(path: Path) -> tuple[LiveRecord, ...]:
    """Return the records of a file, none where there is no file.

    Raises
    ------
    UsageError
        The file is there but holds no such records.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        records = tuple(typed(LiveRecord(**record)) for record in document["records"])
        return tuple(
            replace(record, lags_ms=tuple(record.lags_ms), budgets_ms=tuple(record.budgets_ms))
            for record in records
        )
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UsageError(f"{path} is no live record ({error}); `{COMMAND}` writes it") from None


def keep_records(records: Iterable[LiveRecord], path: Path) -> None:
    """Put records into the file, each in place of the one of its name; whole or not at all."""
    try:
        kept = {record.name: record for record in read_records(path)}
    except UsageError:
        kept = {}  # what cannot be read is replaced
    kept |= {record.name: record for record in records}
    document = to_json(kept[name] for name in sorted(kept, key=_in_order))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes_atomically(path, (json.dumps(document, indent=1) + "\n").encode())


def _in_order(name: str) -> tuple[str, int]:
    """Sort 1024 frames behind 256."""
    server, _, frames = name.partition(", ")
    return server, int(frames.partition(" ")[0] or 0)


_COLUMNS: tuple[tuple[str, str, str, Must | None], ...] = (
    ("lag_median_ms", "lag", "ms", LAG),
    ("lag_p5_ms", "5 % under", "ms", None),
    ("lag_p95_ms", "95 % under", "ms", None),
    ("growth_ms", "change over the run", "ms", NO_GROWTH_MS),
    ("hidden_growth_ms", "of it hidden", "ms", NO_GROWTH_MS),
    ("budget_ms", "what the daemon says", "ms", None),
    ("delay_ms", "of it in the delay line", "ms", None),
    ("resyncs", "resyncs", "", None),
    ("underflows", "underflows", "", None),
    ("dropouts", "dropouts", "", None),
    ("cpu_percent", "CPU", "% of a core", CPU_PERCENT),
    ("memory_growth_kb", "memory grew", "kB", None),
    ("machine_pauses", "the machine stood still", "times", None),
    ("machine_pause_ms", "at worst for", "ms", None),
    ("check_median_ms", "instrument's error", "ms", None),
)
"""Field, column, unit and limit of what the report shows of a record."""

assert {name for name, *_ in _COLUMNS} <= {field.name for field in fields(LiveRecord)}


def live_result(bench: Workbench) -> Section:
    """The last live measurements, or that there never was one."""
    del bench
    title = "Live latency"
    explanation = (
        "How much later than its sound the vibration of `cushion run` comes, transform included, "
        "from the monitor of the sink that is heard to that of the sink that is felt, by server "
        "and by the frames that the daemon's streams take at a time."
    )
    try:
        records = read_records(record_path())
    except UsageError as error:
        return Section(title, explanation, (), (Missing("live latency", str(error), COMMAND),))
    if not records:
        never = Missing("live latency", f"{RECORD} is not there or empty: never run", COMMAND)
        return Section(title, explanation, (), (never,))
    rows = [row for record in records for row in _rows(record)]
    return Section(title, explanation, tuple(rows), footnote=_footnote(records))


def _rows(record: LiveRecord) -> Iterable[Row]:
    note = f"{record.date}, {record.seconds:.0f} s"
    if not record.trusted:
        note += "; not to be trusted: the instrument does not find 0 where there is 0"
    for field, column, unit, must in _COLUMNS:
        value = getattr(record, field)
        if value is None:
            continue
        if field in ("growth_ms", "hidden_growth_ms"):
            value = abs(value)
        asked = must if record.block_frames == USUAL_BLOCK_FRAMES else None
        yield Row(
            record.name,
            float(value),
            unit,
            column,
            asked,
            note=note if field == "lag_median_ms" else "",
        )


def _footnote(records: tuple[LiveRecord, ...]) -> str:
    cpus = ", ".join(dict.fromkeys(f"{record.cpu} ({record.cores} cores)" for record in records))
    loads = [load for record in records for load in (record.load_before, record.load_after)]
    stimuli = ", ".join(dict.fromkeys(record.stimulus for record in records))
    return (
        f"Not part of this run: `{COMMAND}` and `make soak` measure it, on a sound server of their "
        f"own with null sinks, and leave their last results here. Played: {stimuli}. The lag "
        "of every few seconds is that of the vibration's envelope behind the envelope of what "
        "`cushion render` makes of the same sound; a frame's time is the earliest at which it "
        "could be recorded. Hidden is the change of what the daemon does not tell of: it provides "
        "for late callbacks, more of them on a busy machine, and says so. Dropouts are silences "
        "over 2 ms amid vibration. A machine that stands still, as virtual ones do, lets every "
        "stream on it run dry that holds less than the pause; such pauses of all cores at once are "
        "counted, from 10 ms. The instrument's error is the lag that it finds between two "
        "recordings of one monitor. "
        f"{cpus}, load {min(loads):.1f} to {max(loads):.1f}; null sinks have no hardware behind "
        "them, whose own delay comes on top."
    )

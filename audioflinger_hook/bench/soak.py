"""The soak: a million hops of the live form, and the record that the report shows of it.

`make soak` runs it through the tests and leaves its result in docs/soak.json: a document
{"schema": 1, "records": [{SoakRecord}, ...]}, one record a run, the latest of each name.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from audioflinger_hook.bench.growth import NO_GROWTH_KB, NO_GROWTH_OBJECTS, memory_growth
from audioflinger_hook.bench.machine import cpu_model
from audioflinger_hook.bench.measures import SineFit, sine_fit
from audioflinger_hook.bench.report import Missing, Must, Row, Section, number
from audioflinger_hook.bench.signals import PROJECT_ROOT, SAMPLERATE, tone
from audioflinger_hook.bench.workbench import Workbench
from audioflinger_hook.clients import mixdown
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.grid import LiveGrid
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

SCHEMA_VERSION = 1
RECORD = Path("docs/soak.json")
COMMAND = "make soak"
HOPS = 1_000_000

BLOCKSIZE = 4_096
TONE_HZ = 440.0
"""A whole number of cycles a second: one second in a loop is a tone without end."""
TONE_AMPLITUDE = 0.3
SETTLED_AFTER_S = 2
WATCHED_S = 5
NO_DRIFT_DB = Must("<=", 0.01)
PURITY = Must("<=", -60.0)


@dataclass(frozen=True)
class SoakRecord:
    """What one soak run found.

    what: its name; date: UTC, ISO 8601; hops, stream_s: how long the stream was; took_s: CPU time;
    memory_growth_kb, objects_left: what the process holds more at its end; level_drift_db,
    thdn_start_db, thdn_end_db: a steady tone at its end against its start; None where the run
    does not measure it. passed: whether every limit was kept.
    """

    what: str
    date: str
    cpu: str
    hops: int
    stream_s: float
    took_s: float
    passed: bool
    memory_growth_kb: float | None = None
    objects_left: int | None = None
    level_drift_db: float | None = None
    thdn_start_db: float | None = None
    thdn_end_db: float | None = None


def soak_scene(hops: int = HOPS) -> SoakRecord:
    """Return what `hops` hops of the demo scene in a loop leave behind in memory."""
    hop_frames = LiveGrid.at(TransformParameters(), SAMPLERATE).hop_frames
    start_s = time.process_time()
    held = memory_growth(
        HapticTransform(SAMPLERATE, 2), mixdown(demo_scene()), BLOCKSIZE, hops * hop_frames
    )
    return SoakRecord(
        what="demo scene in a loop",
        date=now(),
        cpu=cpu_model(),
        hops=held.frames // hop_frames,
        stream_s=held.frames / SAMPLERATE,
        took_s=time.process_time() - start_s,
        passed=NO_GROWTH_KB.met(held.resident_kb) and NO_GROWTH_OBJECTS.met(held.objects),
        memory_growth_kb=held.resident_kb,
        objects_left=held.objects,
    )


def soak_tone(hops: int = HOPS) -> SoakRecord:
    """Return how far a steady tone drifts in level and purity over `hops` hops."""
    hop_frames = LiveGrid.at(TransformParameters(), SAMPLERATE).hop_frames
    second = tone(TONE_HZ, TONE_AMPLITUDE, 1.0)[:, None]
    seconds = max(SETTLED_AFTER_S + 2 * WATCHED_S, -(-hops * hop_frames // SAMPLERATE))
    start_s = time.process_time()
    transform = HapticTransform(SAMPLERATE, 1)
    watched: list[FloatArray] = []
    for index in range(seconds):
        vibration = transform.process(second)[:, 0]
        at_start = SETTLED_AFTER_S <= index < SETTLED_AFTER_S + WATCHED_S
        if at_start or index >= seconds - WATCHED_S:
            watched.append(vibration)
    first, last = _fit(watched[:WATCHED_S]), _fit(watched[WATCHED_S:])
    drift_db = abs(20.0 * float(np.log10(last.amplitude / first.amplitude)))
    return SoakRecord(
        what=f"steady tone of {TONE_HZ:g} Hz",
        date=now(),
        cpu=cpu_model(),
        hops=seconds * SAMPLERATE // hop_frames,
        stream_s=float(seconds),
        took_s=time.process_time() - start_s,
        passed=NO_DRIFT_DB.met(drift_db) and PURITY.met(last.residual_db),
        level_drift_db=drift_db,
        thdn_start_db=first.residual_db,
        thdn_end_db=last.residual_db,
    )


def _fit(seconds: list[FloatArray]) -> SineFit:
    return sine_fit(np.concatenate(seconds), SAMPLERATE)


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
        return tuple(SoakRecord(**record) for record in document["records"])
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
        "records": [asdict(records[what]) for what in sorted(records)],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes_atomically(path, (json.dumps(document, indent=1) + "\n").encode())


_COLUMNS: tuple[tuple[str, str, str, Must | None], ...] = (
    ("hops", "hops", "", Must(">=", HOPS)),
    ("memory_growth_kb", "growth of memory", "kB", NO_GROWTH_KB),
    ("objects_left", "objects left over", "", NO_GROWTH_OBJECTS),
    ("level_drift_db", "drift of level", "dB", NO_DRIFT_DB),
    ("thdn_start_db", "THD+N at first", "dB", None),
    ("thdn_end_db", "THD+N at the end", "dB", PURITY),
)
"""Field, column, unit and limit of what the report shows of a record."""


def soak_result(bench: Workbench) -> Section:
    """The last soak's result, or that there never was one."""
    del bench
    title = "Soak"
    explanation = (
        f"What only shows after a long time: the live form over {number(HOPS)} hops, more than "
        f"four hours of sound. Not part of this run: `{COMMAND}` does it and leaves its last "
        "result here."
    )
    try:
        records = read_records(record_path())
    except UsageError as error:
        return Section(title, explanation, (), (Missing("soak", str(error), COMMAND),))
    if not records:
        never = Row("last soak", None, column="result", note=f"never run; `{COMMAND}` runs it")
        return Section(title, explanation, (never,))
    rows = []
    for record in records:
        verdict = "passed" if record.passed else "failed"
        when = f"{verdict} on {record.date} in {record.took_s:.0f} s, {record.cpu}"
        for field, column, unit, must in _COLUMNS:
            value = getattr(record, field)
            if value is not None:
                note = when if field == "hops" else ""
                rows.append(Row(record.what, float(value), unit, column, must, note=note))
    return Section(title, explanation, tuple(rows))

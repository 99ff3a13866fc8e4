"""Sections with stored results of other programs: live delays and long-run tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

from audioflinger_hook.config.settings import LiveSettings
from device.errors import UsageError
from tools import soak_record
from tools.bench.report import Missing, Must, Row, Section, number
from tools.bench.workbench import Workbench
from tools.live_latency import burst_record
from tools.live_latency import record as live_record
from tools.live_latency.burst_record import BurstRecord
from tools.live_latency.record import LiveRecord
from tools.records import record_path
from tools.soak_record import SoakRecord

MILLION = 1e6
USUAL_BLOCK_FRAMES = LiveSettings.block_frames
"""The daemon's default block size in frames. The Python engine has limits only for this size."""
LAG = Must("<=", 90.0)
NO_GROWTH_MS = Must("<=", 1.0)
CPU_PERCENT = Must("<=", 8.0)

NATIVE_LIMITS = {
    256: {"lag_median_ms": 12.0, "lag_p95_ms": 16.0, "child_cpu_percent": 2.0, "growth_ms": 0.5},
    1024: {"lag_median_ms": 35.0, "child_cpu_percent": 1.0, "growth_ms": 0.5},
}
"""Limits of the native engine, by the graph's cycle in frames."""

Kept = TypeVar("Kept")
Columns = tuple[tuple[str, str, str, Must | None], ...]

_LIVE_COLUMNS: Columns = (
    ("lag_median_ms", "lag", "ms", LAG),
    ("lag_p5_ms", "5th percentile", "ms", None),
    ("lag_p95_ms", "95th percentile", "ms", None),
    ("growth_ms", "change over the run", "ms", NO_GROWTH_MS),
    ("hidden_growth_ms", "of it not reported", "ms", NO_GROWTH_MS),
    ("budget_ms", "reported by the daemon", "ms", None),
    ("delay_ms", "of it in the delay line", "ms", None),
    ("resyncs", "resyncs", "", None),
    ("underflows", "underflows", "", None),
    ("dropouts", "dropouts", "", None),
    ("cpu_percent", "CPU", "% of a core", CPU_PERCENT),
    ("memory_growth_kb", "memory growth", "kB", None),
    ("child_cpu_percent", "CPU of the native engine", "% of a core", None),
    ("child_memory_growth_kb", "its memory growth", "kB", None),
    ("machine_pauses", "pauses of the machine", "times", None),
    ("machine_pause_ms", "longest pause", "ms", None),
    ("check_median_ms", "instrument's error", "ms", None),
)
_BURST_COLUMNS = (
    ("half_median_ms", "to half, median", Must("<=", 10.0)),
    ("half_p95_ms", "to half, 95 % under", Must("<=", 14.0)),
    ("tenth_median_ms", "to a tenth, median", Must("<=", 6.0)),
    ("tenth_p95_ms", "to a tenth, 95 % under", None),
    ("budget_ms", "reported by the daemon", None),
)
_SOAK_COLUMNS: Columns = (
    ("hops", "hops", "", Must(">=", soak_record.HOPS)),
    ("memory_growth_kb", "growth of memory", "kB", soak_record.NO_GROWTH_KB),
    ("objects_left", "objects left over", "", soak_record.NO_GROWTH_OBJECTS),
    ("level_drift_db", "drift of level", "dB", soak_record.NO_DRIFT_DB),
    ("thdn_start_db", "THD+N at first", "dB", None),
    ("thdn_end_db", "THD+N at the end", "dB", soak_record.PURITY),
)
_ENERGY_COLUMNS: Columns = (
    ("samples", "samples", "million", Must(">=", soak_record.SAMPLES / MILLION)),
    ("energy_creep", "change of the largest energy", "", soak_record.NO_CREEP),
    ("energy_rise", "largest rise after the drive", "", soak_record.PASSIVE),
)
_IDENTIFICATION_COLUMNS: Columns = (
    ("rigs", "rigs", "", Must(">=", soak_record.RIGS)),
    ("f0_error_percent", "largest error of f0", "%", soak_record.F0_ERROR),
    ("q_error_percent", "largest error of Q", "%", soak_record.Q_ERROR),
    ("f0_held_percent", "intervals that hold f0", "%", soak_record.HELD),
    ("q_held_percent", "intervals that hold Q", "%", soak_record.HELD),
)


def live_bursts(_bench: Workbench) -> Section:
    """Return the section with stored delays from tone bursts to their vibration."""
    explanation = (
        "The table shows delays on PipeWire. They are the times from the first sample of a tone "
        "burst to a tenth and to half of the peak of its vibration. The bursts have 150, 440 and "
        "900 Hz. Rows differ by the version of PipeWire, the engine, the tap, the cycle of the "
        "graph (quantum) and the sample rate. The monitor of a sink that drives the graph is one "
        "cycle late. With a recording of this monitor, the measured delay would be too small. The "
        "sound is therefore recorded at an additional sink, which does not drive the graph. The "
        "player is linked to this sink, too. One stream records this sink and the sink of the "
        "vibration."
    )
    return _section(
        "Live bursts", explanation, burst_record.RECORD, burst_record.COMMAND,
        burst_record.read_records, _burst_rows, _burst_footnote,
    )  # fmt: skip


def _burst_rows(record: BurstRecord) -> Iterator[Row]:
    limited = (record.engine, record.tap) == ("native", "streams")
    for field, column, must in _BURST_COLUMNS:
        note = f"{record.date}, {record.bursts} bursts" if field == "half_median_ms" else ""
        yield Row(record.name, getattr(record, field), "ms", column, must if limited else None,
                  note=note)  # fmt: skip


def _burst_footnote(records: tuple[BurstRecord, ...]) -> str:
    return (
        f"`{burst_record.COMMAND}` measures these delays on a private sound server. The server's "
        "null sinks have no hardware delay. Newer versions of PipeWire run in root file systems of "
        "newer Debian versions (`tools/debian_root.sh`). As a check, the method measures 0 ms for "
        "a player that is linked directly to the sink of the vibration."
    )


def live_latency(_bench: Workbench) -> Section:
    """Return the section with stored latencies of `cushion run`."""
    explanation = (
        "The lag is the delay of the vibration of `cushion run` after its sound, including the "
        "latency of the transform. Rows differ by sound server, engine and block size; *quantum* "
        "is the cycle of PipeWire's graph in frames. The lag is measured between the monitors of "
        "two sinks: one for the sound, one for the vibration. On PipeWire, the sound is recorded "
        "at an additional sink, which does not drive the graph."
    )
    return _section(
        "Live latency", explanation, live_record.RECORD, live_record.COMMAND,
        live_record.read_records, _live_rows, _live_footnote,
    )  # fmt: skip


def _section(
    title: str,
    explanation: str,
    record: Path,
    command: str,
    read: Callable[[Path], tuple[Kept, ...]],
    rows: Callable[[Kept], Iterator[Row]],
    footnote: Callable[[tuple[Kept, ...]], str] = lambda _: "",
) -> Section:
    name = title if title.startswith("Soak") else title.lower()
    try:
        kept = read(record_path(record))
    except UsageError as error:
        return Section(title, explanation, (), (Missing(name, str(error), command),))
    shown = [row for each in kept for row in rows(each)]
    if not shown:
        never = Missing(name, f"{record} has no record of it: never run", command)
        return Section(title, explanation, (), (never,))
    return Section(title, explanation, tuple(shown), footnote=footnote(kept))


def _soak(title: str, what: str, columns: Columns, _bench: Workbench) -> Section:
    command = soak_record.COMMAND
    explanation = f"{what} `{command}` runs this test; the table shows its last result."

    def rows(record: SoakRecord) -> Iterator[Row]:
        verdict = "passed" if record.passed else "failed"
        when = f"{verdict} on {record.date} in {record.took_s:.0f} s, {record.cpu}"
        if getattr(record, columns[0][0]) is None:  # a long-run test of another kind
            return
        for index, (field, column, unit, must) in enumerate(columns):
            value = getattr(record, field)
            if value is not None:
                shown = value / MILLION if unit == "million" else float(value)
                yield Row(record.what, shown, unit, column, must, note="" if index else when)

    return _section(title, explanation, soak_record.RECORD, command, soak_record.read_records, rows)


transform_soak = partial(
    _soak,
    "Soak",
    "A *soak* is a test of long duration. Here, the live form processes "
    f"{number(soak_record.HOPS)} hops, which are five hours of sound.",
    _SOAK_COLUMNS,
)
rig_soak = partial(
    _soak,
    "Soak of the rig",
    f"Each model of the rig processes {number(soak_record.SAMPLES / MILLION)} million samples of a "
    "bounded random drive signal, which repeats every ten seconds. The table shows the change of "
    "the largest stored energy from one repetition to the next. It also shows the largest rise of "
    "the stored energy in one step after the end of the signal, when this energy may only fall. "
    "Both changes are relative to the stored energy.",
    _ENERGY_COLUMNS,
)
identification_soak = partial(
    _soak,
    "Soak of the identification",
    f"The table shows errors of the identified f0 and Q for {soak_record.RIGS} random rigs. For "
    "each rig, a sweep of 5 s from 15 to 400 Hz is simulated with the non-linear model. The noise "
    f"of the instruments is -{soak_record.SNR_DB:g} dB relative to the signal; half of the rigs "
    "are on an occupied seat. Rows differ by the peak excursion of the sweep. The true f0 and Q "
    "are computed from the eigenvalues of the rig's linear model. Intervals are 95 % confidence "
    "intervals.",
    _IDENTIFICATION_COLUMNS,
)


def _live_rows(record: LiveRecord) -> Iterator[Row]:
    note = f"{record.date}, {record.seconds:.0f} s"
    if not record.trusted:
        note += "; not to be trusted: the instrument's own error is large"
    for field, column, unit, must in _LIVE_COLUMNS:
        value = getattr(record, field)
        if value is None:
            continue
        if must is NO_GROWTH_MS:
            value = abs(value)
        usual = record.block_frames == USUAL_BLOCK_FRAMES and record.quantum_frames is None
        asked = must if usual else None
        if record.engine == "native":
            limits = NATIVE_LIMITS.get(record.quantum_frames or 0, {})
            asked = Must("<=", limits[field]) if field in limits else None
        shown = note if field == "lag_median_ms" else ""
        yield Row(record.name, float(value), unit, column, asked, note=shown)


def _live_footnote(records: tuple[LiveRecord, ...]) -> str:
    cpus = ", ".join(dict.fromkeys(f"{record.cpu} ({record.cores} cores)" for record in records))
    loads = [load for record in records for load in (record.load_before, record.load_after)]
    stimuli = ", ".join(dict.fromkeys(record.stimulus for record in records))
    return (
        f"`{live_record.COMMAND}` and `make soak` measure these figures on a private sound server. "
        f"The server's null sinks have no hardware delay. The sound is {stimuli}. The lag is "
        "measured every few seconds between the envelope of the vibration and the envelope of "
        "`cushion render` for the same sound. The column *of it not reported* shows how much the "
        "difference between the lag and the delay reported by the daemon changes over the run. "
        "Dropouts are silences over 2 ms within the vibration. Pauses of the machine are times of "
        "10 ms or more in which no core ran. Such pauses occur on virtual machines; streams whose "
        "buffers are shorter than the pause then underrun. The instrument's error is the measured "
        f"lag between two recordings of the same monitor. Machine: {cpus}, load {min(loads):.1f} "
        f"to {max(loads):.1f}."
    )

"""What the report shows of soaks: the last result of each, or that there never was one."""

from __future__ import annotations

from device.errors import UsageError
from tools.bench.measures.random_rigs import F0_ERROR, HELD, Q_ERROR, RIGS, SNR_DB
from tools.bench.report import Missing, Must, Row, Section, number
from tools.bench.rig_soak import (
    NO_CREEP,
    PASSIVE_DEFAULT,
    PASSIVE_FALLBACK,
    SAMPLES,
    STEPPED_SAMPLES,
)
from tools.bench.sections.scaling import NO_GROWTH_KB, NO_GROWTH_OBJECTS
from tools.bench.soak import HOPS, NO_DRIFT_DB, PURITY
from tools.bench.soak_record import COMMAND, RECORD, read_records, record_path
from tools.bench.workbench import Workbench

MILLION = 1e6

_Columns = tuple[tuple[str, str, str, Must | None], ...]
"""Field, column, unit and limit of what is shown of a record; one without the first is not."""

_LIVE: _Columns = (
    ("hops", "hops", "", Must(">=", HOPS)),
    ("memory_growth_kb", "growth of memory", "kB", NO_GROWTH_KB),
    ("objects_left", "objects left over", "", NO_GROWTH_OBJECTS),
    ("level_drift_db", "drift of level", "dB", NO_DRIFT_DB),
    ("thdn_start_db", "THD+N at first", "dB", None),
    ("thdn_end_db", "THD+N at the end", "dB", PURITY),
)
_ENERGY: _Columns = (
    ("samples", "samples", "million", Must(">=", STEPPED_SAMPLES / MILLION)),
    ("energy_creep", "creep of the largest energy", "", NO_CREEP),
    ("energy_rise", "largest rise once the drive stopped", "", PASSIVE_DEFAULT),
    ("energy_from_nowhere", "largest energy from nowhere, a step", "", PASSIVE_FALLBACK),
)
_IDENTIFIED: _Columns = (
    ("rigs", "rigs", "", Must(">=", RIGS)),
    ("f0_error_percent", "largest error of f0", "%", F0_ERROR),
    ("q_error_percent", "largest error of Q", "%", Q_ERROR),
    ("f0_held_percent", "intervals that hold f0", "%", HELD),
    ("q_held_percent", "intervals that hold Q", "%", HELD),
)


def soak_result(bench: Workbench) -> Section:
    """The transform's last soak."""
    del bench
    return _section(
        "Soak",
        f"What only shows after a long time: the live form over {number(HOPS)} hops, more than "
        "four hours of sound.",
        _LIVE,
    )


def rig_soak_result(bench: Workbench) -> Section:
    """The rig's last soak."""
    del bench
    return _section(
        "Soak of the rig",
        f"Whether energy creeps up: {number(SAMPLES / MILLION)} million samples of a bounded "
        "random drive, ten seconds in a loop, on each rung whose energy is known, the step by "
        f"step rung {number(STEPPED_SAMPLES / MILLION)} million since it is about as fast as the "
        "signal; each loop's largest energy against the first one's. Then the drive stops, and "
        "the energy may only fall. All as shares of the stored energy.",
        _ENERGY,
    )


def identified_result(bench: Workbench) -> Section:
    """The identification's last soak."""
    del bench
    return _section(
        "Soak of the identification",
        f"The same random rigs as above, {RIGS} of them at each level of the sweep, every other "
        f"one on a seat that is sat on, at {SNR_DB:g} dB of noise.",
        _IDENTIFIED,
    )


def _section(title: str, what: str, columns: _Columns) -> Section:
    explanation = (
        f"{what} Not part of this run: `{COMMAND}` does it and leaves its last result here."
    )
    try:
        records = read_records(record_path())
    except UsageError as error:
        return Section(title, explanation, (), (Missing(title, str(error), COMMAND),))
    first = columns[0][0]
    records = tuple(record for record in records if getattr(record, first) is not None)
    if not records:
        never = Missing(title, f"{RECORD} has no record of it: never run", COMMAND)
        return Section(title, explanation, (), (never,))
    rows = []
    for record in records:
        verdict = "passed" if record.passed else "failed"
        when = f"{verdict} on {record.date} in {record.took_s:.0f} s, {record.cpu}"
        for field, column, unit, must in columns:
            value = getattr(record, field)
            if value is not None:
                note = when if field == first else ""
                shown = value / MILLION if unit == "million" else float(value)
                rows.append(Row(record.what, shown, unit, column, must, note=note))
    return Section(title, explanation, tuple(rows))

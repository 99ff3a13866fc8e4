"""How figures of the status are shown where their values alone do not say enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from audioflinger_hook.service.figure import label_of, table
from audioflinger_hook.service.meters import FLOOR_DBFS, Level
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.state import Cause, DaemonState

if TYPE_CHECKING:
    from audioflinger_hook.service.status import (
        Endpoint,
        GraphFigures,
        LatencyBudget,
        Partial,
        Xruns,
    )

BAR_CELLS = 16
BAR_RANGE_DB = 60.0
PRINCIPAL_MAX = 4  # principal frequencies that are shown, the strongest


def duration(time_s: float) -> str:
    """Return a duration in its two largest units."""
    if time_s < 59.95:
        return f"{time_s:.1f} s"
    minutes, seconds = divmod(round(time_s), 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{hours} h {minutes:02d} min"
    return f"{hours // 24} d {hours % 24:02d} h"


def bar(level: Level, cells: int = BAR_CELLS) -> str:
    """Return a level as a bar of so many cells."""
    filled = round(cells * min(1.0, max(0.0, 1.0 + level.peak_dbfs / BAR_RANGE_DB)))
    return "█" * filled + "░" * (cells - filled)


def level(one: Level) -> str:
    """Return a level as a bar and in dBFS."""
    if one.peak_dbfs <= FLOOR_DBFS:
        return f"{bar(one)} silence"
    rms_dbfs = max(FLOOR_DBFS, one.rms_dbfs)
    return f"{bar(one)} peak {one.peak_dbfs:6.1f}, rms {rms_dbfs:6.1f} dBFS"


def endpoint(one: Endpoint) -> str:
    """Return name and address."""
    address, name = one_line(one.address), one_line(one.name or "")
    if one.name is None:
        return f"{address} (not there)"
    return address if name in ("", address) else f"{name} ({address})"


def principal(partials: tuple[Partial, ...]) -> str:
    """Return the strongest frequencies as sound -> vibration, strongest first."""
    strongest = sorted(partials, key=lambda one: -one.amplitude)[:PRINCIPAL_MAX]
    shown = ", ".join(f"{one.audio_hz:.0f} → {one.vibration_hz:.0f} Hz" for one in strongest)
    more = len(partials) - len(strongest)
    return f"{shown} and {more} more" if more else shown


def latency(one: LatencyBudget) -> str:
    """Return the total delay and its parts."""
    fields = [(label_of(name, known), name) for name, known, _ in table(type(one))]
    parts = [(label, getattr(one, name)) for label, name in fields if name != "total_ms"]
    signed = ((name, "-" if part_ms < 0.0 else "+", abs(part_ms)) for name, part_ms in parts)
    shown = "".join(f" {sign} {name} {size_ms:.1f}" for name, sign, size_ms in signed if size_ms)
    # In drop-in mode the sound may be delayed more than the vibration.
    early_ms = round(-one.total_ms, 1)
    early = f" ({early_ms:.1f} ms before the sound)" if early_ms > 0.0 else ""
    return f"{one.total_ms:.1f} ms{early}" + (f" = {shown.removeprefix(' + ')}" if shown else "")


def cycle(graph: GraphFigures) -> str:
    """Return the cycle of PipeWire's graph, "" before the first."""
    if not graph.samplerate:
        return ""
    cycle_ms = 1e3 * graph.cycle_frames / graph.samplerate
    return f"{graph.cycle_frames} frames at {graph.samplerate} Hz ({cycle_ms:.1f} ms) a cycle"


def xruns(one: Xruns) -> str:
    """Return both counts."""
    if one.tap is None or one.output is None:
        return "the server does not report them"
    return f"tap {one.tap}, output {one.output}"


def recoveries(counts: Mapping[Cause, int]) -> str:
    """Return the causes that were counted."""
    return ", ".join(f"{cause.value} {count}" for cause, count in counts.items() if count) or "none"


def channels(names: tuple[str, ...]) -> str:
    """Return where an actuator is."""
    return " on " + ", ".join(one_line(name, 40) for name in names)


def seat(is_known: bool) -> str:
    """Return what the predicted exposure goes by."""
    return "by the rig file's seat" if is_known else "as if the seat moved as the mass"


def tone_of_state(state: DaemonState) -> str:
    """Return how good a state is."""
    good = (DaemonState.RUNNING, DaemonState.IDLE)
    return "good" if state in good else "wait" if state is not DaemonState.STOPPING else ""


def tone_of_gain(gain: float) -> str:
    """Return "wait" for a gain that is lowered."""
    return "wait" if gain < 1.0 else ""


def tone_of_xruns(one: Xruns) -> str:
    """Return "good" while no buffer was late, "" where nobody knows."""
    return "wait" if one.tap or one.output else "" if one.tap is None else "good"

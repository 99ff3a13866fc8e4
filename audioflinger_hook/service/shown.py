"""Texts of status figures that the default format cannot show, and tones, which set colours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from audioflinger_hook.service.figure import label_of, table
from audioflinger_hook.service.meters import FLOOR_DBFS, Level
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.state import READY, Cause, DaemonState

if TYPE_CHECKING:
    from audioflinger_hook.service import status

BAR_CELLS = 16
BAR_RANGE_DB = 60.0
PRINCIPAL_MAX = 4  # largest number of principal frequencies in a text


def duration(time_s: float) -> str:
    """Return a duration as text: in seconds, or in its two largest units."""
    if time_s < 59.95:
        return f"{time_s:.1f} s"
    minutes, seconds = divmod(round(time_s), 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours < 48 else f"{hours // 24} d {hours % 24:02d} h"


def bar(level: Level, cells: int = BAR_CELLS) -> str:
    """Return a bar of `cells` characters, empty for a peak up to -60 dBFS, full for 0 dBFS."""
    filled = round(cells * min(1.0, max(0.0, 1.0 + level.peak_dbfs / BAR_RANGE_DB)))
    return "█" * filled + "░" * (cells - filled)


def level(one: Level) -> str:
    """Return a level as a bar and as numbers in dBFS."""
    if one.peak_dbfs <= FLOOR_DBFS:
        return f"{bar(one)} silence"
    return f"{bar(one)} peak {one.peak_dbfs:6.1f}, rms {max(FLOOR_DBFS, one.rms_dbfs):6.1f} dBFS"


def endpoint(one: status.Endpoint) -> str:
    """Return name and address of a tap or device."""
    address, name = one_line(one.address), one_line(one.name or "")
    if one.name is None:
        return f"{address} (not there)"
    return address if name in ("", address) else f"{name} ({address})"


def principal(partials: tuple[status.Partial, ...]) -> str:
    """Return the strongest principal frequencies with their vibration frequencies in Hz."""
    strongest = sorted(partials, key=lambda one: -one.amplitude)[:PRINCIPAL_MAX]
    shown = ", ".join(f"{one.audio_hz:.0f} → {one.vibration_hz:.0f} Hz" for one in strongest)
    more = len(partials) - len(strongest)
    return f"{shown} and {more} more" if more else shown


def latency(one: status.LatencyBudget) -> str:
    """Return the delay between sound and vibration, and the parts of the delay, in ms as text."""
    fields = [(label_of(name, known), name) for name, known, _ in table(type(one))]
    parts = [(label, getattr(one, name)) for label, name in fields if name != "total_ms"]
    signed = ((name, "-" if part_ms < 0.0 else "+", abs(part_ms)) for name, part_ms in parts)
    shown = "".join(f" {sign} {name} {size_ms:.1f}" for name, sign, size_ms in signed if size_ms)
    # In drop-in mode the delay of the sound can exceed the delay of the vibration.
    early_ms = round(-one.total_ms, 1)
    early = f" ({early_ms:.1f} ms before the sound)" if early_ms > 0.0 else ""
    return f"{one.total_ms:.1f} ms{early}" + (f" = {shown.removeprefix(' + ')}" if shown else "")


def offset_reason(reason: str) -> str:
    """Return where the offset comes from, with advice if the delay of the speakers is unknown."""
    advice = ": `cushion sync` measures the delay of the speakers"
    return reason + advice if reason == "not known" else reason


def cycle(graph: status.GraphFigures) -> str:
    """Return the length of a cycle of PipeWire's graph, "" before the first cycle."""
    if not graph.samplerate:
        return ""
    cycle_ms = 1e3 * graph.cycle_frames / graph.samplerate
    return f"{graph.cycle_frames} frames at {graph.samplerate} Hz ({cycle_ms:.1f} ms) a cycle"


def xruns(one: status.Xruns) -> str:
    """Return the numbers of late or lost buffers at tap and output."""
    if one.tap is None or one.output is None:
        return "the server does not report them"
    return f"tap {one.tap}, output {one.output}"


def recoveries(counts: Mapping[Cause, int]) -> str:
    """Return the number of recoveries for each cause."""
    return ", ".join(f"{cause.value} {count}" for cause, count in counts.items() if count) or "none"


def channels(names: tuple[str, ...]) -> str:
    """Return the device channels that an actuator uses."""
    return " on " + ", ".join(one_line(name, 40) for name in names)


def seat(is_known: bool) -> str:
    """Return what the prediction of exposure assumes about the seat."""
    return "by the rig file's seat" if is_known else "as if the seat moved as the mass"


def tone_of_state(state: DaemonState) -> str:
    """Return the tone of a state: "good", "wait" or ""."""
    return "good" if state in READY else "wait" if state is not DaemonState.STOPPING else ""


def tone_of_gain(gain: float) -> str:
    """Return "wait" for a gain below 1, else ""."""
    return "wait" if gain < 1.0 else ""


def tone_of_xruns(one: status.Xruns) -> str:
    """Return "good" without late or lost buffers, "wait" with such buffers, "" if unknown."""
    return "wait" if one.tap or one.output else "" if one.tap is None else "good"

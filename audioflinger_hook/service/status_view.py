"""The status as text, for a terminal of any width."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from audioflinger_hook.service.meters import FLOOR_DBFS, Level
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import (
    ActuatorFigures,
    DeviceRateFigures,
    Endpoint,
    ExposureFigures,
    ProtectionFigures,
    Status,
)

BAR_CELLS = 16
BAR_RANGE_DB = 60.0
WARNINGS_MAX = 20
PRINCIPAL_MAX = 4
"""Principal frequencies that are shown, the strongest."""

_COLOURS = {
    DaemonState.RUNNING: "bold green",
    DaemonState.IDLE: "green",
    DaemonState.STOPPING: "dim",
    DaemonState.STARTING: "cyan",
}


def status_view(status: Status) -> Table:
    """Return the table that rich prints, one row for each part of the status.

    Names from the sound server and from users are shown as text, never as markup.
    """
    table = Table.grid(padding=(0, 1, 0, 0), expand=False)
    table.add_column(style="dim", overflow="fold", min_width=1)
    table.add_column(overflow="fold", min_width=1)
    for label, value in _rows(status):
        table.add_row(Text(label), value)
    return table


def _device_clock(rate: DeviceRateFigures) -> Text:
    return Text(f"{rate.measured_hz:.1f} Hz, {rate.ppm:+.1f} ppm off {rate.nominal_hz} Hz")


def _rows(status: Status) -> list[tuple[str, Text]]:
    rows = [
        ("cushion", Text(f"{one_line(status.version)}, process {status.pid}")),
        ("state", _state(status)),
        ("tap", _tap(status)),
        ("device", _endpoint(status.device)),
        ("sound", _level(status.levels.sound, "cyan")),
        *([("volume", Text(f"{status.volume_db:+.1f} dB, undone"))] if status.volume_db else []),
        ("vibration", _level(status.levels.vibration, "yellow")),
        *([("device clock", _device_clock(status.device_rate))] if status.device_rate else []),
        *([("principal", _principal(status))] if status.principal else []),
        *([("server", _server(status))] if status.server else []),
        *([("profile", Text(one_line(status.profile)))] if status.profile else []),
        *([("engine", _engine(status))] if status.engine else []),
        ("latency", _latency(status)),
        *([] if status.engine == "native" else _python_rows(status)),
        ("xruns", _xruns(status)),
        ("recoveries", _recoveries(status)),
        (
            "samples",
            Text(f"{status.limited_samples} limited, {status.replaced_samples} replaced"),
        ),
    ]
    for number, actuator in enumerate(status.actuators, 1):
        rows += _actuator(number, actuator)
    if status.protection and not status.actuators:
        rows.append(("protection", _protection(status.protection)))
    if status.exposure and not status.actuators:
        rows.append(("exposure", _exposure(status.exposure)))
    if status.effects_bypassed:
        names = ", ".join(one_line(name) for name in status.effects_bypassed)
        rows.append(("bypassed", Text(names, "red")))
    shown = status.warnings[-WARNINGS_MAX:]
    if status.warnings[:-WARNINGS_MAX]:
        left_out = len(status.warnings) - len(shown)
        rows.append(("warning", Text(f"({left_out} earlier ones left out)", "yellow")))
    rows += [("warning", Text(one_line(warning), "yellow")) for warning in shown]
    return rows


def _python_rows(status: Status) -> list[tuple[str, Text]]:
    """Return the rows of the Python engine's streams and buffers."""
    line, buffers = status.delay_line, status.buffer_times
    return [
        (
            "delay line",
            Text(
                f"{one_line(line.state)}, {line.delay_ms:.1f} of {line.target_ms:.1f} ms, "
                f"{line.ratio_ppm:+.1f} ppm; {_count(line.resyncs, 'resync')}, "
                f"{_count(line.underflows, 'underflow')}, {_count(line.overflows, 'overflow')}"
            ),
        ),
        (
            "buffers",
            Text(
                f"{buffers.share_percent:.1f} % of {buffers.buffer_ms:.1f} ms; "
                f"p50 {buffers.p50_ms:.2f}, p99 {buffers.p99_ms:.2f}, max {buffers.max_ms:.2f} ms"
            ),
        ),
    ]


def _state(status: Status) -> Text:
    colour = _COLOURS.get(status.state, "bold yellow")
    text = Text.assemble((status.state.value, colour), f" for {duration(status.since_s)}")
    if status.reason:
        text.append(f": {one_line(status.reason)}")
    if status.muted:
        text.append(", muted", "bold yellow")
    return text


def _engine(status: Status) -> Text:
    why = f" ({one_line(status.engine_reason)})" if status.engine_reason else ""
    return Text(f"{one_line(status.engine)}{why}")


def _endpoint(endpoint: Endpoint) -> Text:
    address = one_line(endpoint.address)
    if endpoint.name is None:
        return Text.assemble(address, (" (not there)", "yellow"))
    name = one_line(endpoint.name)
    return Text(address if name in ("", address) else f"{name} ({address})")


def _tap(status: Status) -> Text:
    text, graph = _endpoint(status.tap), status.graph
    if graph is None:
        return text
    way = "from its streams" if graph.tap == "streams" else "from its monitor"
    return text.append(f", {way}")


def _server(status: Status) -> Text:
    graph, name = status.graph, one_line(status.server)
    if graph is None or not graph.samplerate:
        return Text(name)
    cycle_ms = 1e3 * graph.cycle_frames / graph.samplerate
    return Text(
        f"{name}, {graph.cycle_frames} frames at {graph.samplerate} Hz ({cycle_ms:.1f} ms) a cycle"
    )


def _xruns(status: Status) -> Text:
    xruns = status.xruns
    if xruns.tap is None or xruns.output is None:
        return Text("the server does not report them", "dim")
    return Text(f"tap {xruns.tap}, output {xruns.output}")


def _share(level: Level) -> float:
    return min(1.0, max(0.0, 1.0 + level.peak_dbfs / BAR_RANGE_DB))


def _level(level: Level, colour: str) -> Text:
    filled = round(_share(level) * BAR_CELLS)
    bar = ("█" * filled, colour), ("░" * (BAR_CELLS - filled), "dim")
    if level.peak_dbfs <= FLOOR_DBFS:
        return Text.assemble(*bar, " silence")
    return Text.assemble(
        *bar, f" peak {level.peak_dbfs:6.1f}, rms {max(FLOOR_DBFS, level.rms_dbfs):6.1f} dBFS"
    )


def _principal(status: Status) -> Text:
    """Return the strongest frequencies as sound -> vibration, strongest first."""
    strongest = sorted(status.principal, key=lambda one: -one.amplitude)[:PRINCIPAL_MAX]
    text = Text()
    for one in strongest:
        text.append(", " if text else "")
        text.append(f"{one.audio_hz:.0f}", "cyan").append(" → ")
        text.append(f"{one.vibration_hz:.0f} Hz", "yellow")
    more = len(status.principal) - len(strongest)
    return text.append(f" and {more} more" if more else "")


def _latency(status: Status) -> Text:
    latency = status.latency
    driving = f"driving {latency.driving_ms:.1f} + " if latency.driving_ms else ""
    driving += f"actuator {latency.delay_ms:.1f} + " if latency.delay_ms else ""
    # In drop-in mode the sound may be delayed more than the vibration.
    early_ms = round(-latency.total_ms, 1)
    early = f" ({early_ms:.1f} ms before the sound)" if early_ms > 0.0 else ""
    return Text(
        f"{latency.total_ms:.1f} ms{early} = tap {latency.tap_ms:.1f} + transform "
        f"{latency.transform_ms:.1f} + {driving}delay line {latency.delay_line_ms:.1f} + output "
        f"{latency.output_ms:.1f} {'-' if latency.offset_ms < 0 else '+'} offset "
        f"{abs(latency.offset_ms):.1f}"
    )


def _actuator(number: int, actuator: ActuatorFigures) -> list[tuple[str, Text]]:
    """Return the rows of one actuator: settings, level, protection and exposure."""
    words = [
        f"{one_line(actuator.source)} on {', '.join(one_line(c, 40) for c in actuator.channels)}",
        one_line(actuator.rig),
    ]
    # Default settings are not shown.
    words += [f"{actuator.gain_db:.1f} dB"] if actuator.gain_db else []
    words += [one_line(actuator.polarity)] if actuator.polarity != "normal" else []
    words += [f"{actuator.delay_ms:.1f} ms later"] if actuator.delay_ms else []
    rows = [
        (f"actuator {number}", Text(", ".join(words))),
        ("  level", _level(actuator.level, "yellow")),
    ]
    if actuator.protection:
        rows.append(("  protection", _protection(actuator.protection)))
    if actuator.exposure:
        rows.append(("  exposure", _exposure(actuator.exposure)))
    return rows


def _recoveries(status: Status) -> Text:
    counted = [f"{cause.value} {n}" for cause, n in status.recoveries.items() if n]
    return Text(", ".join(counted) or "none")


def _protection(protection: ProtectionFigures) -> Text:
    coil = "" if protection.coil_c is None else f", coil {protection.coil_c:.0f} °C"
    text = Text(f"{protection.limited_blocks} of {_count(protection.blocks, 'block')} limited")
    if protection.infeasible_blocks:
        text.append(f", {protection.infeasible_blocks} silenced", "red")
    text.append(f"; gain {protection.gain:.2f}")
    if protection.limited_by:
        text.append(f" for {one_line(protection.limited_by)}", "yellow")
    text.append(
        f", least {protection.least_gain:.2f}; excursion {protection.excursion_mm:.2f} mm{coil}"
    )
    if protection.makeup_db:
        text.append(f"; damping made up by {protection.makeup_db:.1f} dB")
    if protection.strength_db is not None:
        text.append(f", felt {protection.strength_db:+.1f} dB against no damping")
    return text


def _exposure(exposure: ExposureFigures) -> Text:
    colour = "red" if exposure.above_limit else "yellow" if exposure.above_action else ""
    above = "above the limit, " if exposure.above_limit else "above action, "
    seat = "by the rig file's seat" if exposure.knows_seat else "as if the seat moved as the mass"
    text = Text.assemble(
        (above if colour else "", colour),
        f"A(8) {exposure.a8_m_s2:.3g} m/s², VDV {exposure.vdv:.3g} m/s^1.75 (predicted, {seat}); "
        f"now {exposure.running_m_s2:.3g} m/s²",
    )
    if exposure.since:
        text.append(f"; since {one_line(exposure.since[:16].replace('T', ' '))}")
    if exposure.cap != "off":
        colour = "yellow" if exposure.cap_gain < 1.0 else ""
        text.append(f"; cap {one_line(exposure.cap)}, gain {exposure.cap_gain:.2f}", colour)
    return text


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def meter_line(status: Status, width: int) -> str:
    """Return state, levels and the strongest frequency in one line of at most `width` cells."""
    cells = max(4, min(BAR_CELLS, (width - 50) // 2))
    bars = [
        f"{name} {'█' * filled}{'░' * (cells - filled)}"
        for name, level in (("sound", status.levels.sound), ("felt", status.levels.vibration))
        for filled in [round(cells * _share(level))]
    ]
    words = [status.state.value + (", muted" if status.muted else ""), *bars]
    if status.principal:
        strongest = max(status.principal, key=lambda one: one.amplitude)
        words.append(f"{strongest.audio_hz:.0f} → {strongest.vibration_hz:.0f} Hz")
    return "  ".join(words)[: max(0, width)]


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

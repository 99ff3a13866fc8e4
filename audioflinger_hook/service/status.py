"""The status of a running daemon: the table of all its figures; see `Figure`.

`cushion status --json` prints it: names are keys, groups are objects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from audioflinger_hook.service import shown
from audioflinger_hook.service.figure import Row, figure, rows
from audioflinger_hook.service.meters import BufferTimes, Level
from audioflinger_hook.service.state import Cause, DaemonState


@dataclass(frozen=True)
class Endpoint:
    """A tap or a device."""

    address: str = figure("address in the config")
    name: str | None = figure("name of the node that is there; null for none", None)


@dataclass(frozen=True)
class DeviceRateFigures:
    """Rate of a USB device's own clock, by its feedback."""

    nominal_hz: int = figure("rate at which the device was opened", kind="gauge")
    measured_hz: float = figure("measured rate")
    ppm: float = figure("how much faster than nominal", label="faster by")


@dataclass(frozen=True)
class GraphFigures:
    """How PipeWire runs the native engine, and what is tapped there."""

    cycle_frames: int = figure("frames of the latest cycle (quantum)", kind="gauge")
    samplerate: int = figure("rate of the graph", unit="Hz", kind="gauge")
    tap: str = figure("streams, or monitor: one cycle later", row="tap", show="from its {}")
    tap_reason: str = figure("why the monitor is tapped", "")


@dataclass(frozen=True)
class Levels:
    """Levels of the sound and of the vibration."""

    sound: Level = figure("of the sound", Level, row="sound", show=shown.level, tone="sound")
    vibration: Level = figure(
        "of the vibration", Level, row="vibration", show=shown.level, tone="felt"
    )
    channels: tuple[Level, ...] = figure("of each channel of the sound", ())


@dataclass(frozen=True)
class Partial:
    """A principal frequency."""

    audio_hz: float = figure("of the sound")
    vibration_hz: float = figure("of its vibration")
    amplitude: float = figure("amplitude of the vibration, 1 for full scale")


@dataclass(frozen=True)
class Application:
    """An application that has a stream."""

    name: str = figure("name of the application")
    plays: bool = figure("whether it plays")
    is_felt: bool = figure("whether it vibrates")


PART = "cushion_delay_part_seconds{part}"


@dataclass(frozen=True)
class LatencyBudget:
    """Parts of the delay between a sound and its vibration."""

    tap_ms: float = figure("delay of the tap", 0.0, metric=PART)
    transform_ms: float = figure("latency of the transform", 0.0, metric=PART)
    driving_ms: float = figure("latency of damping and protection", 0.0, metric=PART)
    delay_line_ms: float = figure("delay between two clocks", 0.0, metric=PART)
    output_ms: float = figure("latency of the device", 0.0, metric=PART)
    delay_ms: float = figure("longest set for an actuator", 0.0, label="actuator", metric=PART)
    offset_ms: float = figure(
        "the user's, less the sound's delay in drop-in mode", 0.0, metric=PART
    )
    total_ms: float = figure("vibration behind its sound", 0.0, metric="cushion_delay_seconds")

    @classmethod
    def of(cls, **parts_ms: float) -> LatencyBudget:
        """Return the budget of these parts with its total."""
        return cls(**parts_ms, total_ms=sum(parts_ms.values()))


@dataclass(frozen=True)
class DelayLineFigures:
    """State of the delay line between two clocks."""

    target_ms: float = figure("delay aimed at", 0.0, read="target_s", scale=1e3)
    delay_ms: float = figure("present delay", 0.0, read="delay_s", scale=1e3)
    ratio_ppm: float = figure(
        "the output's clock over the tap's", 0.0, label="clock", metric="cushion_clock_ratio"
    )
    resyncs: int = figure("restarts of the delay line", 0, metric="cushion_resyncs")
    underflows: int = figure(
        "how often the delay line lacked frames", 0, tone="wait", metric="cushion_underruns"
    )
    overflows: int = figure("how often the delay line lost frames", 0)
    state: str = figure("what the delay line does", "empty", read="state.value", show="{}")


XRUNS = "cushion_xruns{stream}"


@dataclass(frozen=True)
class Xruns:
    """Late or lost buffers; with the native engine, the server's own errors of its two nodes."""

    tap: int | None = figure("at the tap; null if the server does not tell", 0, metric=XRUNS)
    output: int | None = figure("at the output; null if the server does not tell", 0, metric=XRUNS)


@dataclass(frozen=True)
class ProtectionFigures:
    """Blocks of 2 ms since the start, and readings of the worst channel."""

    blocks: int = figure("blocks so far")
    limited_blocks: int = figure("blocks with reduced drive", label="limited")
    infeasible_blocks: int = figure(
        "blocks that were silenced", label="silenced", quiet=0, tone="bad"
    )
    replaced_samples: int = figure("unusable samples", quiet=0)
    gain: float = figure(
        "gain of the drive, 0 to 1", tone=shown.tone_of_gain, metric="cushion_protection_gain_ratio"
    )
    least_gain: float = figure("smallest gain so far")
    limited_by: str = figure('what lowers the gain, "" for nothing', tone="wait")
    excursion_mm: float = figure(
        "predicted amplitude",
        label="predicted excursion",
        read="excursion_m",
        scale=1e3,
        metric="cushion_excursion_meters",
    )
    coil_c: float | None = figure(
        "predicted temperature; null without thermal data",
        metric="cushion_coil_temperature_celsius",
    )
    makeup_db: float = figure(
        "gain that makes up for what damping takes",
        0.0,
        show="damping made up by {:.1f} dB",
        quiet=0.0,
    )
    strength_db: float | None = figure(
        "perceived strength against no damping and no protection; null if unknown",
        None,
        show="felt {:+.1f} dB against no damping",
    )


@dataclass(frozen=True)
class ExposureFigures:
    """Predicted vibration of the seat today, weighted by Wk of ISO 2631-1."""

    time_s: float = figure("duration of vibration")
    running_m_s2: float = figure("r.m.s. of the last second", label="now")
    a8_m_s2: float = figure(
        "daily exposure A(8)",
        label="predicted A(8)",
        metric="cushion_exposure_a8_meters_per_second_squared",
    )
    vdv: float = figure("vibration dose value", unit="m/s^1.75", show="VDV {:.3g} m/s^1.75")
    above_action: bool = figure("whether it is above the action value of 2002/44/EC", tone="wait")
    above_limit: bool = figure(
        "whether it is above the limit value of 2002/44/EC",
        tone="bad",
        metric="cushion_exposure_above_limit",
    )
    extrapolated: float = figure("share of energy above 80 Hz, weighted by extrapolation", show="")
    knows_seat: bool = figure("whether the rig file describes the seat", False, show=shown.seat)
    cap: str = figure("the setting `exposure_cap`", "off", read="exposure_cap", quiet="off")
    cap_gain: float = figure(
        "gain of the cap, 0 to 1", 1.0, read="exposure_gain", quiet=1.0, tone=shown.tone_of_gain
    )
    since: str = figure(
        'since when it counts; "" for the start',
        "",
        show=lambda local: f"since {local[:16].replace('T', ' ')}",
    )


@dataclass(frozen=True)
class ActuatorFigures:
    """One of several actuators: its settings and readings."""

    source: str = figure("part of the sound that it plays", show="{}")
    channels: tuple[str, ...] = figure(
        "channels of the device, as in the config", show=shown.channels
    )
    rig: str = figure("name or file of its rig", show="{}")
    gain_db: float = figure("level", show="{:.1f} dB", quiet=0.0)
    polarity: str = figure("normal or inverted", show="{}", quiet="normal")
    delay_ms: float = figure("delay", show="{:.1f} ms later", quiet=0.0)
    level: Level = figure("after protection", row="level", show=shown.level, tone="felt")
    protection: ProtectionFigures | None = figure(
        "of its rig; null without", row="protection", panel="rig"
    )
    exposure: ExposureFigures | None = figure(
        "by its rig; null without", row="exposure", panel="rig"
    )


def status_rows(status: Status) -> list[Row]:
    """Return the rows that show a status."""
    if status.actuators:  # each shows its own
        status = replace(status, protection=None, exposure=None)
    return rows(status)


@dataclass(frozen=True)
class Status:
    """The whole status at one time."""

    version: str = figure("version of the daemon", row="cushion", show="{}")
    pid: int = figure("process of the daemon", row="cushion", show="process {}", kind="gauge")
    state: DaemonState = figure(
        "what the daemon does",
        show="{}",
        tone=shown.tone_of_state,
        metric="cushion_state{state}",
        words=tuple(one.value for one in DaemonState),
    )
    reason: str = figure("why, where the daemon waits", row="state", show=": {}")
    since_s: float = figure(
        "how long the state lasts", row="state", show=lambda s: f"for {shown.duration(s)}"
    )
    tap: Endpoint = figure("where sound comes from", show=shown.endpoint)
    device: Endpoint = figure("where vibration goes", show=shown.endpoint)
    muted: bool = figure(
        "whether it is muted", False, row="state", tone="wait", metric="cushion_muted"
    )
    levels: Levels = figure("levels of sound and vibration", Levels)
    volume_db: float = figure(
        "the listener's volume, 0 dB for 100 %; levels are without it",
        0.0,
        show="{:+.1f} dB, undone",
        quiet=0.0,
    )
    device_rate: DeviceRateFigures | None = figure(
        "clock of a USB device with feedback; null without", None, row="device clock"
    )
    principal: tuple[Partial, ...] = figure(
        "what the latest hop vibrates", (), show=shown.principal
    )
    applications: tuple[Application, ...] = figure("applications that have a stream", ())
    server: str = figure('the sound server, "" for none', "", show="{}")
    graph: GraphFigures | None = figure(
        "PipeWire's graph; null without the native engine", None, row="server", show=shown.cycle
    )
    profile: str = figure("profile that plays", "", read="settings.profile", show="{}")
    engine: str = figure(
        'native or python, "" before one plays',
        "",
        kind="state",
        show="{}",
        metric="cushion_engine{engine}",
        words=("native", "python"),
    )
    engine_reason: str = figure("why not the native one", "", row="engine", show=" ({})")
    engine_pid: int = figure(
        "process of the native engine, 0 for none", 0, read="process_id", kind="gauge"
    )
    latency: LatencyBudget = figure("delay of the vibration", LatencyBudget, show=shown.latency)
    delay_line: DelayLineFigures = figure(
        "delay line between two clocks: the Python engine's",
        DelayLineFigures,
        panel="health",
        quiet=DelayLineFigures(),
    )
    buffer_times: BufferTimes = figure(
        "computing times of buffers: the Python engine's",
        BufferTimes,
        row="load",
        panel="health",
        quiet=BufferTimes(),
    )
    xruns: Xruns = figure(
        "late or lost buffers",
        Xruns,
        row="dropouts",
        panel="health",
        show=shown.xruns,
        tone=shown.tone_of_xruns,
    )
    recoveries: Mapping[Cause, int] = figure(
        "what was lost and came back, by cause",
        lambda: MappingProxyType(dict.fromkeys(Cause, 0)),
        kind="count",
        panel="health",
        show=shown.recoveries,
        tone=lambda counts: "wait" if any(counts.values()) else "good",
        metric="cushion_recoveries{cause}",
    )
    limited_samples: int = figure(
        "samples limited at full scale",
        0,
        row="samples",
        panel="health",
        show="{} limited",
        tone="wait",
        metric="cushion_limited_samples",
    )
    replaced_samples: int = figure(
        "unusable samples, which count as 0",
        0,
        row="samples",
        show="{} replaced",
        metric="cushion_replaced_samples",
    )
    protection: ProtectionFigures | None = figure(
        "of the actuator with the least gain; null without", None, panel="rig"
    )
    exposure: ExposureFigures | None = figure(
        "each reading where it is worst; null without", None, panel="rig"
    )
    effects_bypassed: tuple[str, ...] = figure(
        "effects that are bypassed", (), row="bypassed", panel="health", tone="bad"
    )
    actuators: tuple[ActuatorFigures, ...] = figure(
        "in the order of the config", (), row="actuator", panel="rig"
    )
    warnings: tuple[str, ...] = figure(
        "what the user should know", (), row="warning", panel="health", tone="wait"
    )

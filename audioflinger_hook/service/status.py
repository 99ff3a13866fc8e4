"""The figures in the status of a daemon; see `Figure`. In JSON, a group of figures is an object."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from audioflinger_hook.service import shown
from audioflinger_hook.service.figure import Row, figure, rows
from audioflinger_hook.service.meters import BufferTimes, Level
from audioflinger_hook.service.state import Cause, DaemonState

PART, XRUNS = "cushion_delay_part_seconds{part}", "cushion_xruns{stream}"  # metrics


@dataclass(frozen=True)
class Endpoint:
    """A tap or a device."""

    address: str = figure("address in the config")
    name: str | None = figure("name of the present node; null without a node", None)


@dataclass(frozen=True)
class DeviceRateFigures:
    """Rate of a USB device's own clock, according to the device's feedback."""

    nominal_hz: int = figure("rate at which the device was opened", kind="gauge")
    measured_hz: float = figure("measured rate")
    ppm: float = figure("deviation of the measured rate from the nominal rate", label="faster by")


@dataclass(frozen=True)
class GraphFigures:
    """PipeWire's graph while the native engine plays."""

    cycle_frames: int = figure("frames of the latest cycle (quantum)", kind="gauge")
    samplerate: int = figure("rate of the graph", unit="Hz", kind="gauge")
    tap: str = figure(
        "where sound is read: streams, or monitor, which is one cycle later",
        row="tap",
        show="from its {}",
    )
    tap_reason: str = figure("why sound is read from the monitor", "")


@dataclass(frozen=True)
class Levels:
    """Levels of the sound and of the vibration."""

    sound: Level = figure("level of the sound", Level, row="sound", show=shown.level, tone="sound")
    vibration: Level = figure(
        "level of the vibration", Level, row="vibration", show=shown.level, tone="felt"
    )
    channels: tuple[Level, ...] = figure("level of each channel of the sound", ())


@dataclass(frozen=True)
class Partial:
    """A principal frequency of the sound, and its vibration."""

    audio_hz: float = figure("frequency of the sound")
    vibration_hz: float = figure("frequency of the vibration")
    amplitude: float = figure("amplitude of the vibration, 1 for full scale")


@dataclass(frozen=True)
class Application:
    """An application with a stream of sound."""

    name: str = figure("name of the application")
    plays: bool = figure("whether the application plays sound")
    is_felt: bool = figure("whether the application's sound causes vibration")
    rule: str = figure(
        'why all or part of it is left out, such as "call" or "alert", or the rule that acts', ""
    )


@dataclass(frozen=True)
class LatencyBudget:
    """Parts of the delay between a sound and its vibration."""

    tap_ms: float = figure("delay of the tap", 0.0, metric=PART)
    transform_ms: float = figure("latency of the transform", 0.0, metric=PART)
    driving_ms: float = figure("latency of damping and protection", 0.0, metric=PART)
    delay_line_ms: float = figure("delay of the delay line", 0.0, metric=PART)
    output_ms: float = figure("latency of the device", 0.0, metric=PART)
    delay_ms: float = figure(
        "longest delay that is set for an actuator", 0.0, label="actuator", metric=PART
    )
    offset_ms: float = figure(
        "offset of the vibration, minus the delay of drop-in mode", 0.0, metric=PART
    )
    total_ms: float = figure(
        "delay of the vibration after its sound", 0.0, metric="cushion_delay_seconds"
    )

    @classmethod
    def of(cls, **parts_ms: float) -> "LatencyBudget":
        """Return the given parts, in ms, with their sum."""
        return cls(**parts_ms, total_ms=sum(parts_ms.values()))


@dataclass(frozen=True)
class DelayLineFigures:
    """State of the delay line between the clocks of tap and output."""

    target_ms: float = figure("target delay", 0.0, read="target_s", scale=1e3)
    delay_ms: float = figure("present delay", 0.0, read="delay_s", scale=1e3)
    ratio_ppm: float = figure(
        "rate of the output's clock relative to the tap's clock",
        0.0,
        label="clock",
        metric="cushion_clock_ratio",
    )
    resyncs: int = figure("restarts of the delay line", 0, metric="cushion_resyncs")
    underflows: int = figure(
        "how often the delay line lacked frames", 0, tone="wait", metric="cushion_underruns"
    )
    overflows: int = figure("how often the delay line lost frames", 0)
    state: str = figure("state of the delay line", "empty", read="state.value", show="{}")


@dataclass(frozen=True)
class Xruns:
    """Numbers of late or lost buffers. With the native engine, PipeWire counts them."""

    tap: int | None = figure("late or lost buffers at the tap; null if unknown", 0, metric=XRUNS)
    output: int | None = figure(
        "late or lost buffers at the output; null if unknown", 0, metric=XRUNS
    )


@dataclass(frozen=True)
class ProtectionFigures:
    """Protection of a rig: counts of 2 ms blocks since the start; worst values of all channels."""

    blocks: int = figure("number of processed blocks")
    limited_blocks: int = figure("number of blocks with reduced drive", label="limited")
    infeasible_blocks: int = figure(
        "number of silenced blocks", label="silenced", quiet=0, tone="bad"
    )
    replaced_samples: int = figure("invalid samples, replaced by 0", quiet=0)
    gain: float = figure(
        "gain of the drive, 0 to 1", tone=shown.tone_of_gain, metric="cushion_protection_gain_ratio"
    )
    least_gain: float = figure("smallest gain since the start")
    limited_by: str = figure('quantity that limits the gain; "" for none', tone="wait")
    excursion_mm: float = figure(
        "predicted excursion (amplitude)",
        label="predicted excursion",
        read="excursion_m",
        scale=1e3,
        metric="cushion_excursion_meters",
    )
    coil_c: float | None = figure(
        "predicted temperature of the coil; null without thermal data",
        metric="cushion_coil_temperature_celsius",
    )
    makeup_db: float = figure(
        "gain that compensates the attenuation by damping",
        0.0,
        show="damping made up by {:.1f} dB",
        quiet=0.0,
    )
    strength_db: float | None = figure(
        "perceived strength relative to no damping and no protection; null if unknown",
        None,
        show="felt {:+.1f} dB against no damping",
    )


@dataclass(frozen=True)
class ExposureFigures:
    """Predicted vibration of the seat today, weighted by Wk of ISO 2631-1."""

    time_s: float = figure("duration of vibration")
    running_m_s2: float = figure("weighted r.m.s. acceleration of the last second", label="now")
    a8_m_s2: float = figure(
        "daily exposure A(8)",
        label="predicted A(8)",
        metric="cushion_exposure_a8_meters_per_second_squared",
    )
    vdv: float = figure("vibration dose value", unit="m/s^1.75", show="VDV {:.3g} m/s^1.75")
    above_action: bool = figure(
        "whether the exposure is above the action value of 2002/44/EC", tone="wait"
    )
    above_limit: bool = figure(
        "whether the exposure is above the limit value of 2002/44/EC",
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
        'time from which the exposure counts; "" for the start',
        "",
        show=lambda local: f"since {local[:16].replace('T', ' ')}",
    )


@dataclass(frozen=True)
class ActuatorFigures:
    """Settings and measurements of one configured actuator."""

    source: str = figure("part of the sound that the actuator plays", show="{}")
    channels: tuple[str, ...] = figure(
        "channels of the device, as in the config", show=shown.channels
    )
    rig: str = figure("name or file of the actuator's rig", show="{}")
    gain_db: float = figure("gain of the actuator", show="{:.1f} dB", quiet=0.0)
    polarity: str = figure("polarity: normal or inverted", show="{}", quiet="normal")
    delay_ms: float = figure("delay of the actuator", show="{:.1f} ms later", quiet=0.0)
    level: Level = figure("level after protection", row="level", show=shown.level, tone="felt")
    protection: ProtectionFigures | None = figure(
        "protection of the actuator's rig, or null", row="protection", panel="rig"
    )
    exposure: ExposureFigures | None = figure(
        "exposure by the actuator's rig, or null", row="exposure", panel="rig"
    )


def status_rows(status: "Status") -> list[Row]:
    """Return the rows of a status."""
    if status.actuators:  # each actuator has rows for protection and exposure
        status = replace(status, protection=None, exposure=None)
    return rows(status)


@dataclass(frozen=True)
class Status:
    """Complete status at one time."""

    version: str = figure("version of the daemon", row="cushion", show="{}")
    pid: int = figure("process id of the daemon", row="cushion", show="process {}", kind="gauge")
    state: DaemonState = figure(
        "state of the daemon",
        show="{}",
        tone=shown.tone_of_state,
        metric="cushion_state{state}",
        words=tuple(one.value for one in DaemonState),
    )
    reason: str = figure("why the daemon waits", row="state", show=": {}")
    since_s: float = figure(
        "duration of the present state", row="state", show=lambda s: f"for {shown.duration(s)}"
    )
    tap: Endpoint = figure("where sound comes from", show=shown.endpoint)
    device: Endpoint = figure("where vibration goes", show=shown.endpoint)
    muted: bool = figure(
        "whether the vibration is muted", False, row="state", tone="wait", metric="cushion_muted"
    )
    levels: Levels = figure("levels of sound and vibration", Levels)
    volume_db: float = figure(
        "the listener's volume, 0 dB for 100 %; the levels exclude this volume",
        0.0,
        show="{:+.1f} dB, undone",
        quiet=0.0,
    )
    device_rate: DeviceRateFigures | None = figure(
        "clock of a USB device with feedback; null without such a device", None, row="device clock"
    )
    principal: tuple[Partial, ...] = figure(
        "principal frequencies of the last hop", (), show=shown.principal
    )
    applications: tuple[Application, ...] = figure("applications that have a stream", ())
    rule: str = figure("[[application]] rule that acts; empty for none", "", show="{}")
    server: str = figure('the sound server, "" for none', "", show="{}")
    graph: GraphFigures | None = figure(
        "PipeWire's graph; null without the native engine", None, row="server", show=shown.cycle
    )
    profile: str = figure("profile in use", "", read="settings.profile", show="{}")
    engine: str = figure(
        'engine: native or python; "" before the start',
        "",
        kind="state",
        show="{}",
        metric="cushion_engine{engine}",
        words=("native", "python"),
    )
    engine_reason: str = figure("why the native engine is not used", "", row="engine", show=" ({})")
    engine_pid: int = figure(
        "process id of the native engine; 0 for none", 0, read="process_id", kind="gauge"
    )
    latency: LatencyBudget = figure("delay of the vibration", LatencyBudget, show=shown.latency)
    offset_ms: float = figure(
        "offset of the vibration; below 0, drop-in mode delays the sound",
        0.0,
        read="alignment.offset_s",
        scale=1e3,
        row="offset",
        panel="health",
        show="{:.1f} ms",
    )
    offset_reason: str = figure(
        "where the offset comes from",
        "",
        read="alignment.offset.reason",
        row="offset",
        show=shown.offset_reason,
    )
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
        "number of recoveries from a loss, by cause",
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
        "invalid samples, replaced by 0",
        0,
        row="samples",
        show="{} replaced",
        metric="cushion_replaced_samples",
    )
    protection: ProtectionFigures | None = figure(
        "protection of the actuator with the smallest gain; null without protection",
        None,
        panel="rig",
    )
    exposure: ExposureFigures | None = figure(
        "largest reading of all actuators for each figure; null without exposure", None, panel="rig"
    )
    effects_bypassed: tuple[str, ...] = figure(
        "bypassed effects", (), row="bypassed", panel="health", tone="bad"
    )
    actuators: tuple[ActuatorFigures, ...] = figure(
        "actuators in the order of the config", (), row="actuator", panel="rig"
    )
    warnings: tuple[str, ...] = figure(
        "warnings for the user", (), row="warning", panel="health", tone="wait"
    )

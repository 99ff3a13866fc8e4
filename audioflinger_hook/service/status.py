"""The status of a running daemon, as `cushion status --json` prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from audioflinger_hook.service.meters import BufferTimes, Level
from audioflinger_hook.service.state import Cause, DaemonState


@dataclass(frozen=True)
class Endpoint:
    """A tap or a device: the configured address, and the name of the available node, or None."""

    address: str
    name: str | None = None


@dataclass(frozen=True)
class DeviceRateFigures:
    """Rate of a USB device's own clock, by its feedback. ppm: how much faster than nominal.

    nominal_hz: as the device was opened.
    """

    nominal_hz: int
    measured_hz: float
    ppm: float


@dataclass(frozen=True)
class GraphFigures:
    """How PipeWire runs the native engine, and what is tapped there.

    cycle_frames: frames of the latest cycle (quantum), 0 before the first. samplerate: Hz of the
    graph. tap: "streams", or "monitor", which is one cycle later. tap_reason: why the monitor, ""
    for streams.
    """

    cycle_frames: int
    samplerate: int
    tap: str
    tap_reason: str = ""


@dataclass(frozen=True)
class Levels:
    """Levels of the sound and of the vibration; channels: of the sound."""

    sound: Level = field(default_factory=Level)
    vibration: Level = field(default_factory=Level)
    channels: tuple[Level, ...] = ()


@dataclass(frozen=True)
class Partial:
    """A principal frequency: of the sound, of its vibration, and its amplitude in full scale."""

    audio_hz: float
    vibration_hz: float
    amplitude: float


@dataclass(frozen=True)
class Application:
    """An application that has a stream: whether it plays, and whether it vibrates."""

    name: str
    plays: bool
    is_felt: bool


@dataclass(frozen=True)
class LatencyBudget:
    """Parts of the delay between a sound and its vibration, in ms.

    offset_ms: the user's offset, less the delay of the sound in drop-in mode. driving_ms: latency
    of damping and protection. delay_ms: the longest delay set for an actuator. total_ms: delay of
    that actuator relative to the sound.
    """

    tap_ms: float = 0.0
    transform_ms: float = 0.0
    delay_line_ms: float = 0.0
    output_ms: float = 0.0
    offset_ms: float = 0.0
    driving_ms: float = 0.0
    delay_ms: float = 0.0
    total_ms: float = 0.0

    @classmethod
    def of(cls, **parts_ms: float) -> LatencyBudget:
        """Return the budget of these parts with its total."""
        return cls(**parts_ms, total_ms=sum(parts_ms.values()))


@dataclass(frozen=True)
class DelayLineFigures:
    """State of the delay line: target and actual delay in ms.

    ratio_ppm: how much faster than nominal the delay line is read. resyncs, underflows, overflows:
    counts of jumps, of missing frames and of lost frames. state: value of `DelayState`.
    """

    target_ms: float = 0.0
    delay_ms: float = 0.0
    ratio_ppm: float = 0.0
    resyncs: int = 0
    underflows: int = 0
    overflows: int = 0
    state: str = "empty"


@dataclass(frozen=True)
class Xruns:
    """Counts of late or lost buffers in tap and output; None where the server does not tell.

    With the native engine they are the server's own errors of its two nodes.
    """

    tap: int | None = 0
    output: int | None = 0


@dataclass(frozen=True)
class ProtectionFigures:
    """Counts of blocks of 2 ms since the start, and readings of the worst channel.

    limited_blocks: blocks with reduced drive; infeasible_blocks: blocks that had to be silenced.
    gain, least_gain: current and smallest gain of the drive, 0 to 1. limited_by: cause of the gain,
    "" for none. excursion_mm: predicted amplitude. coil_c: predicted temperature in degrees C, None
    if the rig lacks thermal data. makeup_db: gain by which damping makes up for what it takes, 0
    without damping. strength_db: perceived strength against no damping and no protection, None if
    unknown.
    """

    blocks: int
    limited_blocks: int
    infeasible_blocks: int
    replaced_samples: int
    gain: float
    least_gain: float
    limited_by: str
    excursion_mm: float
    coil_c: float | None
    makeup_db: float = 0.0
    strength_db: float | None = None


@dataclass(frozen=True)
class ExposureFigures:
    """Predicted vibration of the seat today, weighted by Wk of ISO 2631-1.

    time_s: duration of vibration. running_m_s2: r.m.s. of the last second. a8_m_s2: A(8). vdv:
    m/s^1.75. above_action, above_limit: whether the action value and the limit value of 2002/44/EC
    are exceeded. extrapolated: share of energy above 80 Hz, where the weighting is extrapolated.
    knows_seat: whether the rig file describes the seat; if not, the seat is assumed to move like
    the mass. cap, cap_gain: the setting `exposure_cap` and its gain, 0 to 1. since: local time
    since when it counts, such as "2026-05-01T09:30+02:00"; "" for the start.
    """

    time_s: float
    running_m_s2: float
    a8_m_s2: float
    vdv: float
    above_action: bool
    above_limit: bool
    extrapolated: float
    knows_seat: bool = False
    cap: str = "off"
    cap_gain: float = 1.0
    since: str = ""


@dataclass(frozen=True)
class ActuatorFigures:
    """One of several actuators: its settings and readings.

    channels: as the config names them; rig: name or file; level: after protection and gain.
    protection, exposure: None if the actuator's rig has neither.
    """

    source: str
    channels: tuple[str, ...]
    rig: str
    gain_db: float
    polarity: str
    delay_ms: float
    level: Level
    protection: ProtectionFigures | None
    exposure: ExposureFigures | None


@dataclass(frozen=True)
class Status:
    """The whole status at one time.

    since_s: duration of the state. recoveries: counts by cause. effects_bypassed: names of effects.
    limited_samples, replaced_samples: as in `cushion render --json`, since the start. protection,
    exposure: None without protection; with several actuators, the figures with the least gain, and
    each reading of the exposure where it is worst. actuators: in the order of the config. profile:
    "" before the first sound. engine: "native" or "python", "" before one plays; engine_reason: why
    not the native one. engine_pid: the native engine's process, 0 for none. volume_db: the
    listener's volume, 0 dB for 100 %; the sound's level and the vibration are those without it.
    device_rate: None if the device is no USB device with a feedback endpoint that plays. principal:
    what the latest hop vibrates, as it is played. applications: those that have a stream. muted: by
    a page. server: name and version of the sound server, "" for none. graph: None but with the
    native engine.
    """

    version: str
    pid: int
    state: DaemonState
    reason: str
    since_s: float
    tap: Endpoint
    device: Endpoint
    levels: Levels = field(default_factory=Levels)
    latency: LatencyBudget = field(default_factory=LatencyBudget)
    delay_line: DelayLineFigures = field(default_factory=DelayLineFigures)
    xruns: Xruns = field(default_factory=Xruns)
    buffer_times: BufferTimes = field(default_factory=BufferTimes)
    recoveries: Mapping[Cause, int] = field(
        default_factory=lambda: MappingProxyType(dict.fromkeys(Cause, 0))
    )
    effects_bypassed: tuple[str, ...] = ()
    limited_samples: int = 0
    replaced_samples: int = 0
    protection: ProtectionFigures | None = None
    exposure: ExposureFigures | None = None
    actuators: tuple[ActuatorFigures, ...] = ()
    profile: str = ""
    engine: str = ""
    engine_reason: str = ""
    engine_pid: int = 0
    volume_db: float = 0.0
    device_rate: DeviceRateFigures | None = None
    principal: tuple[Partial, ...] = ()
    applications: tuple[Application, ...] = ()
    muted: bool = False
    server: str = ""
    graph: GraphFigures | None = None
    warnings: tuple[str, ...] = ()

"""What a running daemon tells about itself: one document, as `cushion status --json` prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from audioflinger_hook.service.json_codec import from_json, to_json
from audioflinger_hook.service.meters import BufferTimes, Level
from audioflinger_hook.service.state import Cause, DaemonState


@dataclass(frozen=True)
class Endpoint:
    """A tap or a device: its address as it was asked for, and what is there, None for nothing."""

    address: str
    name: str | None = None


@dataclass(frozen=True)
class Levels:
    """What comes in and what goes out."""

    sound: Level = field(default_factory=Level)
    vibration: Level = field(default_factory=Level)


@dataclass(frozen=True)
class LatencyBudget:
    """Where the time goes between a sound and its vibration, in ms.

    offset_ms: what the user added, less what drop-in mode delays the sound by. driving_ms: what
    damping and protection add. delay_ms: what was asked for by the actuator that comes last.
    total_ms: by how much the vibration comes later than the sound is played, that of this actuator.
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
    def of(
        cls,
        *,
        tap_ms: float,
        transform_ms: float,
        delay_line_ms: float,
        output_ms: float,
        offset_ms: float,
        driving_ms: float = 0.0,
        delay_ms: float = 0.0,
    ) -> LatencyBudget:
        """Return the budget with its sum."""
        in_order = (tap_ms, transform_ms, delay_line_ms, output_ms, offset_ms)
        parts_ms = (*in_order, driving_ms, delay_ms)
        return cls(*parts_ms, sum(parts_ms))


@dataclass(frozen=True)
class DelayLineFigures:
    """The delay line: what its delay should be and is, in ms, and how it is steered there.

    ratio_ppm: how much faster than nominal it is read. resyncs, underflows, overflows: how often
    it jumped, ran out of frames, lost some. state: in the delay line's own words.
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
    """How often sound was late or lost in the tap, and vibration in the output."""

    tap: int = 0
    output: int = 0


@dataclass(frozen=True)
class ProtectionFigures:
    """Counts of blocks of 2 ms since the start, and the last one's readings, the worst channel's.

    limited_blocks: where some drive was taken away; infeasible_blocks: where all of it was, since
    nothing else would have kept the limits. gain, least_gain: of the drive, now and the smallest,
    0 to 1. limited_by: what asked for the gain now, "" where nothing did. excursion_mm: amplitude
    that is predicted; coil_c: predicted, degrees C, None where the rig does not say how it warms
    up.
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


@dataclass(frozen=True)
class ExposureFigures:
    """Predicted vibration of the seat since the start, weighted by Wk of ISO 2631-1.

    time_s: of vibration; running_m_s2: r.m.s. of the last second; a8_m_s2: A(8); vdv: m/s^1.75;
    above_action, above_limit: whether 2002/44/EC says so; extrapolated: share of the energy above
    80 Hz, where the weighting is an extrapolation. knows_seat: whether the seat is the rig file's,
    else it is taken to move as the mass does. cap, cap_gain: what `exposure_cap` says, and the gain
    that is left by it, 0 to 1.
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


@dataclass(frozen=True)
class ActuatorFigures:
    """One of several actuators: what was asked for, and what it gets.

    source: of its vibration; channels: of the device, as the config names them; rig: by its own
    name or its file's. level: of what it gets, protection and its own level included. protection,
    exposure: None where nothing is done for it.
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
    """The whole picture; made by one thread at one time, read by any.

    version: the program's. pid: its process. since_s: how long the state has lasted.
    recoveries: how many there were, for every cause. effects_bypassed: the names of the effects
    that are. limited_samples, replaced_samples: as of `cushion render --json`, since the start.
    protection, exposure: None without protection; of several actuators those of the one with the
    least gain, and of the one with the largest dose. actuators: each of them, in the config's
    order. profile: its name, "" before there is any sound.
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
    warnings: tuple[str, ...] = ()

    def to_json(self) -> str:
        """Return the document as one line of JSON.

        Raises
        ------
        ValueError
            A number is not finite.
        """
        return to_json(self)

    @classmethod
    def from_json(cls, text: str | bytes) -> Status:
        """Return the status that a document holds.

        Raises
        ------
        UsageError
            It is not exactly such a document; see `document.from_json`.
        """
        return from_json(cls, text)

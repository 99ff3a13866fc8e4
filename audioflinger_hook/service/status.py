"""What a running daemon tells about itself: one document, as `cushion status --json` prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from audioflinger_hook.service.buffer_times import BufferTimes
from audioflinger_hook.service.json_codec import from_json, to_json
from audioflinger_hook.service.levels import Level
from audioflinger_hook.service.rig_figures import (
    ActuatorFigures,
    ExposureFigures,
    ProtectionFigures,
)
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

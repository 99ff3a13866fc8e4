"""The facts of a set-up, as plain values: "" or None if unknown. Any thread may use them.

Facts hold no names of streams, windows or applications.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.service.runtime_folder import Holder
from audioflinger_hook.service.status import Status


@dataclass(frozen=True)
class SystemFacts:
    """Versions and permissions.

    priority: what an audio thread gets: "real-time", "nice" or "". rtprio_limit: the soft limit
    RLIMIT_RTPRIO. rtkit: whether rtkit is on the system bus; None if no program can ask the bus.
    """

    program: str = ""
    python: str = ""
    kernel: str = ""
    distribution: str = ""
    pipewire: str = ""
    wireplumber: str = ""
    is_root: bool = False
    priority: str = ""
    rtprio_limit: int = 0
    rtkit: bool | None = None


@dataclass(frozen=True)
class SinkFacts:
    """A sink. volume_db: relative to 100 %, None for silence. state: in PipeWire's graph.

    is_playing: whether a stream plays to it now. declared_ms: the delay that it declares.
    rate_is_known: whether it has this samplerate; a suspended sink of a card may have another one.
    """

    name: str
    samplerate: int
    channels: int
    muted: bool = False
    volume_db: float | None = 0.0
    is_playing: bool = False
    state: str = ""
    declared_ms: float | None = None
    rate_is_known: bool = True


@dataclass(frozen=True)
class GraphFacts:
    """PipeWire's graph. A forced rate in Hz or quantum in frames is 0 if it is not forced.

    links: of the tap and of the vibration, as "FROM -> TO (STATE)".
    """

    version: str
    rate_hz: int = 0
    forced_hz: int = 0
    allowed_hz: tuple[int, ...] = ()
    quantum_frames: int = 0
    forced_frames: int = 0
    has_session_manager: bool = True
    links: tuple[str, ...] = ()

    @property
    def clock_hz(self) -> int:
        """The rate at which the graph runs: the forced rate, else the configured rate."""
        return self.forced_hz or self.rate_hz

    @property
    def cycle_frames(self) -> int:
        """The length of a cycle: the forced quantum, else the configured quantum."""
        return self.forced_frames or self.quantum_frames


@dataclass(frozen=True)
class ServerFacts:
    """The sound server. kind: "PipeWire", "PulseAudio" or "". error: why it cannot be asked.

    hangs: whether a server accepts connections but does not answer. players: what plays vibration
    on this server, such as "process 1234".
    """

    kind: str = ""
    version: str = ""
    error: str = ""
    hangs: bool = False
    default_sink: str = ""
    sinks: tuple[SinkFacts, ...] = ()
    players: tuple[str, ...] = ()
    graph: GraphFacts | None = None

    def sink(self, name: str) -> SinkFacts | None:
        """Return the sink with exactly this name, or None."""
        return next((sink for sink in self.sinks if sink.name == name), None)


@dataclass(frozen=True)
class ConfigFacts:
    """The config file. error: why it cannot be read. device: "" if it names none.

    device_error: why its device is not on the server. is_on_server: whether the device is a sink.
    """

    path: str = ""
    exists: bool = False
    error: str = ""
    mistakes: tuple[Mistake, ...] = ()
    warnings: tuple[str, ...] = ()
    tap: str = "default"
    device: str = ""
    engine: str = "auto"
    device_error: str = ""
    is_on_server: bool = True


@dataclass(frozen=True)
class FolderFacts:
    """A folder of the program. problem: why it cannot be used. can_make: whether --fix can help.

    free_bytes: space for this user on its disk.
    """

    what: str
    path: str
    free_bytes: int | None = None
    problem: str = ""
    can_make: bool = False


@dataclass(frozen=True)
class PluginFacts:
    """The plugin's files. built: path of the compiled plugin, "" if it is missing.

    installed: "", "current", "other version" or "missing" (a configuration refers to it).
    native_problem: what the native engine lacks. alsa_problem: what the Python engine lacks.
    """

    built: str = ""
    installed: str = ""
    native_problem: str = ""
    alsa_problem: str = ""


@dataclass(frozen=True)
class DaemonFacts:
    """The running daemon. error: why it does not answer, "" if it answers or none runs.

    holder: the daemon that the lock file names. is_locked: whether a daemon holds the lock.
    service: state of the systemd service, such as "active" or "failed"; "" if unknown.
    """

    status: Status | None = None
    error: str = ""
    holder: Holder | None = None
    is_locked: bool = False
    service: str = ""


@dataclass(frozen=True)
class Delay:
    """A measured delay from sound to vibration. delay_ms: None if it could not be measured.

    bursts: number of bursts whose vibration was found. cycle_ms: the true delay may be this much
    longer, because the monitor of a sink that drives PipeWire's graph is one cycle late.
    was_played: whether the bursts were played. reason: why the delay is unknown.
    """

    delay_ms: float | None = None
    bursts: int = 0
    cycle_ms: float = 0.0
    was_played: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Facts:
    """All facts. heard, felt: names of the sinks of sound and vibration, "" if unknown."""

    system: SystemFacts = field(default_factory=SystemFacts)
    server: ServerFacts = field(default_factory=ServerFacts)
    config: ConfigFacts = field(default_factory=ConfigFacts)
    folders: tuple[FolderFacts, ...] = ()
    plugin: PluginFacts = field(default_factory=PluginFacts)
    daemon: DaemonFacts = field(default_factory=DaemonFacts)
    heard: str = ""
    felt: str = ""
    delay: Delay | None = None

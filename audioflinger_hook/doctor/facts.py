"""The facts of a set-up: "" or None if unknown. No I/O."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from audioflinger_hook.config.settings import LiveSettings
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.daemon.native.chain import NAME
from audioflinger_hook.service.runtime_folder import Holder
from audioflinger_hook.service.status import Status
from audioflinger_hook.sources import parse_tap
from device.address import parse_device
from device.errors import CushionError
from device.server import ServerSnapshot
from device.server.graph import Graph
from device.server.snapshot import Sink

OURS = rf"{NAME}(?:-(\d+)-\d+)?\.(tap|vibration)"  # names of the nodes of chains


@dataclass(frozen=True)
class Folder:
    """A folder of the program. free_bytes: on its disk. problem: why it cannot be used."""

    what: str
    path: str
    free_bytes: int = 0
    problem: str = ""


@dataclass(frozen=True)
class Delay:
    """A measured delay from sound to vibration. delay_ms: None if it could not be measured.

    The true delay may be one cycle of PipeWire's graph longer, because the monitor of a sink that
    drives the graph is one cycle late. bursts: number of bursts whose vibration was found.
    was_played: whether the bursts were played. reason: why the delay is unknown.
    """

    delay_ms: float | None = None
    bursts: int = 0
    was_played: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Facts:
    """All facts. `report` shows no streams, windows or applications of them."""

    # versions and permissions
    program: str = ""
    system: str = ""  # Python, distribution and kernel
    pipewire: str = ""
    wireplumber: str = ""
    is_root: bool = False
    is_realtime: bool = False  # whether an audio thread gets real-time priority
    rtprio_limit: int = 0  # soft limit RLIMIT_RTPRIO
    rtkit: bool | None = None  # whether it is on the system bus; None if the bus does not answer

    # the sound server
    server: ServerSnapshot | None = None  # without a daemon's silent helper sinks
    server_error: str = ""  # why the server cannot be asked
    hangs: bool = False  # whether a server accepts connections but does not answer
    players: tuple[str, ...] = ()  # what plays vibration on it, such as "process 1234"
    graph: Graph | None = None  # of PipeWire
    latencies_s: Mapping[str, float] = field(default_factory=dict)  # on PulseAudio, by sink

    # the config file
    config_error: str = ""  # why it cannot be read
    mistakes: tuple[Mistake, ...] = ()
    config_warnings: tuple[str, ...] = ()
    live: LiveSettings = field(default_factory=LiveSettings)
    tap_error: str = ""  # why its tap is missing
    device_error: str = ""  # why its device is missing
    is_on_server: bool = True  # whether its device is a sink

    # folders, and the plugin's files
    folders: tuple[Folder, ...] = ()
    is_built: bool = False
    installed: str = ""  # "current", "of another version", or "missing" if a file refers to it
    native_problem: str = ""  # what the native engine lacks
    alsa_problem: str = ""  # what the Python engine lacks

    # the daemon
    status: Status | None = None
    daemon_error: str = ""  # why it does not answer; "" if it answers or none runs
    holder: Holder | None = None  # named in the lock file
    is_locked: bool = False  # whether a daemon holds the lock
    service: str = ""  # state of the systemd service, such as "active" or "failed"
    errors: tuple[str, ...] = ()  # last errors and warnings in the service's journal

    delay: Delay | None = None

    @property
    def heard(self) -> Sink | None:
        """The output of the sound: the daemon's, else the config's."""
        if self.server is None:
            return None
        name = self.server.default_sink
        with suppress(CushionError):
            address = parse_tap(self.status.tap.address if self.status else self.live.tap[0])
            name = address.name if address.kind == "sink" else name
        return self.server.sink(name)

    @property
    def felt(self) -> Sink | None:
        """The output of the vibration: the daemon's, else the config's."""
        with suppress(CushionError):
            address = self.status.device.address if self.status else self.live.device
            return parse_device(address or "").sink(self.server) if self.server else None
        return None

    def clock(self, setting: str) -> list[int]:
        """Return the numbers, except 0, in a setting of PipeWire's clock, such as "force-rate"."""
        text = str(self.graph.settings.get(f"clock.{setting}")) if self.graph else ""
        return [number for number in map(int, re.findall(r"\d+", text)) if number]

"""Interface of all inputs, and the base class of inputs and outputs."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from audioflinger_hook.daemon.run_config import RunConfig
from device.server import PulseConnection, ServerSnapshot
from device.server.left_out import LeftOut

NOTHING = "nothing plays"  # message for the user while the daemon is idle


class AudioNode(Protocol):
    """A source of sound or destination of vibration: a monitor, a sink, a card, a file."""

    @property
    def name(self) -> str:
        """The node's name in messages."""

    @property
    def samplerate(self) -> int:
        """Sample rate in Hz; 0 stands for the rate of the mix."""

    @property
    def channels(self) -> int:
        """Number of channels; 0 stands for the channels of the vibration."""


@dataclass(frozen=True)
class FixedNode:
    """An `AudioNode` that does not change."""

    name: str
    samplerate: int
    channels: int


class Endpoint(ABC):
    """An input or an output, with its address."""

    needs_server = False  # whether the endpoint uses the sound server
    may_rest = False  # whether the endpoint may be closed while nothing plays

    def __init__(self, address: object) -> None:
        self.address = address

    def __str__(self) -> str:
        return str(self.address)

    @property
    @abstractmethod
    def name(self) -> str | None:
        """Name of the open node, None while closed."""

    @property
    def xruns(self) -> int:
        """Number of late or lost buffers since the start."""
        return 0

    @property
    def warnings(self) -> list[str]:
        """Problems to show the user, one line each."""
        return []

    def configure(self, config: RunConfig) -> None:  # noqa: B027
        """Store settings for streams that are opened later."""

    def retarget(self, config: RunConfig) -> bool:
        """Change to the config's tap or device; return False if this needs another `Endpoint`."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Close the endpoint until the next `maintain`. Repeated calls do nothing."""


class Input(Endpoint):
    """A source of sound. why_silent: tells the user why no sound arrives while it is idle."""

    address: str
    why_silent = NOTHING

    @property
    def ended(self) -> bool:
        """Whether all sound and its vibration have been played; live sound never ends."""
        return False

    @abstractmethod
    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> AudioNode:
        """Return the node to capture. NotFoundError: no node can be captured without feedback.

        device: sink of the vibration, or None.
        """

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the server's indexes of the streams that play to the located node."""
        return frozenset()

    def volume_db(self, snapshot: ServerSnapshot, left_out: LeftOut | None = None) -> float:
        """Return the volume in dB that the server applied to the captured sound, 0 if unknown.

        left_out: which streams are not captured.
        """
        return 0.0

    def monitor_db(self, snapshot: ServerSnapshot) -> float:
        """Return, in dB, the part of `volume_db` that sink and monitor apply."""
        return 0.0

    def is_muted(self, snapshot: ServerSnapshot) -> bool:
        """Whether the listener has muted the sound; the vibration must then be muted."""
        return False

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """Return whether sound has arrived while the input is closed. The call raises nothing."""
        return False

    @abstractmethod
    def maintain(self, connection: PulseConnection | None, now_s: float) -> None:
        """Open, check or reopen the stream. After LostError or NotFoundError, call it again."""

    def end(self) -> None:
        """Close the input for the rest of the run. Repeated calls do nothing."""
        self.close()

"""The supervisor's interface of all inputs, and the base of inputs and outputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from audioflinger_hook.daemon.run_config import RunConfig
from device.server import PulseConnection, ServerSnapshot

NOTHING = "nothing plays"  # why no sound arrives while nothing is wrong


class AudioNode(Protocol):
    """Something that sound comes from or vibration goes to: a monitor, a sink, a card, a file."""

    @property
    def name(self) -> str:
        """The node's name in messages."""

    @property
    def samplerate(self) -> int:
        """Hz; 0 if it takes the rate of the mix."""

    @property
    def channels(self) -> int:
        """Count; 0 if it takes the channels of the vibration."""


@dataclass(frozen=True)
class FixedNode:
    """An `AudioNode` that is always available."""

    name: str
    samplerate: int
    channels: int


class Endpoint(ABC):
    """An input or an output, with its address. For the supervising thread alone."""

    needs_server = False  # whether it belongs to the sound server

    def __init__(self, address: object) -> None:
        self.address = address

    def __str__(self) -> str:
        return str(self.address)

    @property
    def may_rest(self) -> bool:
        """Whether closing it while nothing plays loses no sound."""
        return False

    @property
    @abstractmethod
    def name(self) -> str | None:
        """Name of the open node, None while closed."""

    @property
    def xruns(self) -> int:
        """Count of late or lost buffers that PortAudio reported."""
        return 0

    @property
    def warnings(self) -> list[str]:
        """Problems to tell the user, one line each."""
        return []

    def configure(self, config: RunConfig) -> None:  # noqa: B027
        """Store settings for streams that are opened later; by default none."""

    def retarget(self, config: RunConfig) -> bool:
        """Change to another tap or device; return False if that needs another object."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Close the endpoint until the next `maintain`. May be repeated; raises nothing."""


class Input(Endpoint):
    """Where sound comes from."""

    address: str

    @property
    def ended(self) -> bool:
        """Whether all sound was played, and its vibration as well."""
        return False

    @abstractmethod
    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> AudioNode:
        """Find the node to capture, which is never on `device`. NotFoundError: it is not there."""

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the streams that may play into the located node."""
        return frozenset()

    @property
    def why_silent(self) -> str:
        """Why no sound arrives while the daemon is idle, for the user."""
        return NOTHING

    def volume_db(self, snapshot: ServerSnapshot) -> float:
        """Return the volume that its sound carries, as far as it is known; 0 dB for 100 %."""
        return 0.0

    def monitor_db(self, snapshot: ServerSnapshot) -> float:
        """Return the part of `volume_db` that its monitor adds to the streams' own volumes."""
        return 0.0

    def is_muted(self, snapshot: ServerSnapshot) -> bool:
        """Whether the listener has muted what is tapped, so that nothing is to be felt."""
        return False

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """Return whether sound arrived while closed; called while nothing plays. Raises nothing."""
        return False

    @abstractmethod
    def maintain(self, connection: PulseConnection | None, now_s: float) -> None:
        """Open, check or reopen the stream from the located node.

        LostError, NotFoundError: the next call tries again; other errors are final.
        """

    def end(self) -> None:
        """Close for good. May be repeated."""
        self.close()

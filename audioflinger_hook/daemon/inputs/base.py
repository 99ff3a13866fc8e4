"""What every input offers to the supervisor, and what inputs and outputs share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from audioflinger_hook.daemon.run_config import RunConfig
from device.server import PulseConnection, ServerSnapshot


class AudioNode(Protocol):
    """Something that sound comes from or vibration goes to: a monitor, a sink, a card, a file."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def samplerate(self) -> int:
        """Hz; 0 if it takes the rate of the mix."""
        ...

    @property
    def channels(self) -> int:
        """Count; 0 if it takes the channels of the vibration."""
        ...


@dataclass(frozen=True)
class FixedNode:
    """An `AudioNode` that is always available."""

    name: str
    samplerate: int
    channels: int


class Endpoint(ABC):
    """An input or an output. For the supervising thread alone.

    address: as the user wrote it.
    """

    needs_server = False
    """Whether the sound server provides it."""

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
        """What is open, None while nothing is."""

    @property
    def xruns(self) -> int:
        """Count of late or lost buffers that PortAudio reported."""
        return 0

    @property
    def warnings(self) -> list[str]:
        """Problems that the user should know, one line each."""
        return []

    def configure(self, config: RunConfig) -> None:  # noqa: B027
        """Take what applies to streams that are opened later; by default nothing."""

    def retarget(self, config: RunConfig) -> bool:
        """Take another tap or device; return False if that needs another object."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Close what is open, until the next `maintain`. May be repeated; raises nothing."""


class Input(Endpoint):
    """Where sound comes from."""

    address: str

    @property
    def ended(self) -> bool:
        """Whether all sound was played, and its vibration as well."""
        return False

    @abstractmethod
    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> AudioNode:
        """Find what to capture. device: the sink that vibration goes to, which is never tapped.

        NotFoundError: it is not available, or must not be tapped.
        """

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the streams that may play into what was located."""
        return frozenset()

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """Return whether sound arrived while the input is closed; raises nothing.

        The supervisor calls it regularly while nothing plays.
        """
        return False

    @abstractmethod
    def maintain(self, connection: PulseConnection | None, now_s: float) -> None:
        """Open, check or reopen what was located.

        LostError, NotFoundError: the next call tries again; other errors are final.
        """

    def end(self) -> None:
        """Close for good. May be repeated."""
        self.close()

"""What the supervisor knows of both sides: where sound comes from, and where vibration goes.

Live sides belong to the sound server, a card and paced sides need none; each kind pairs with each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from device.drive import ActuatorSettings
from device.server import PulseConnection, ServerSnapshot
from device.units import Float32Array

Fill = Callable[[Float32Array, float], None]
"""(out, now_s): writes what is played next."""


Actuated = Sequence[ActuatorSettings]
"""What hangs at a device's channels; empty where all of them get the vibration as it is."""


class Place(Protocol):
    """Something that is there: a monitor, a sink, a file. samplerate: Hz."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def samplerate(self) -> int:
        """Its rate; 0 where it takes that of the mix."""
        ...

    @property
    def channels(self) -> int:
        """Its channels; 0 where it takes those of the vibration."""
        ...


class Side(Protocol):
    """What both sides have in common. For the supervising thread alone."""

    @property
    def needs_server(self) -> bool:
        """Whether it is the sound server's."""
        ...

    @property
    def may_rest(self) -> bool:
        """Whether nothing is lost while it is closed because nothing plays."""
        ...

    @property
    def name(self) -> str | None:
        """What is open, None while nothing is."""
        ...

    @property
    def xruns(self) -> int:
        """How often PortAudio told of lateness."""
        ...

    @property
    def warnings(self) -> list[str]:
        """What a user should know, a line each."""
        ...

    def close(self) -> None:
        """Fall silent; `keep` goes on from there. Again too; it raises nothing."""
        ...

    def end(self, *, keep: bool) -> None:
        """Let go of it for good; keep: what was written stays, else it is dropped. Again too.

        WriteError: it could not be kept.
        """
        ...


class InputSide(Side, Protocol):
    """Where sound comes from."""

    @property
    def ended(self) -> bool:
        """Whether it has come to its end, and its vibration has run out."""
        ...

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> Place:
        """Find what is to be captured; device: the sink that vibration goes to, never tapped.

        Raises NotFoundError where there is nothing, or nothing that may be tapped.
        """
        ...

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the streams that may sound in what was located at any moment."""
        ...

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """Return whether sound was heard while it is closed; it raises nothing.

        Called now and then while nothing plays; where that may be wrong, it listens with as little
        effort as possible, until `keep` or `close`.
        """
        ...

    def keep(self, connection: PulseConnection | None, now_s: float) -> None:
        """Bring it nearer to what was located.

        Raises LostError or NotFoundError where another try follows, other errors for good.
        """
        ...


class OutputSide(Side, Protocol):
    """Where vibration goes."""

    @property
    def summary(self) -> str:
        """What a user may want to know of the whole run, one line; mostly empty."""
        ...

    @property
    def is_open(self) -> bool:
        """Whether it plays, or did until a moment ago."""
        ...

    def locate(self, snapshot: ServerSnapshot | None) -> Place:
        """Find the device. NotFoundError: it is not there; no other is taken instead."""
        ...

    def keep(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Bring it nearer to what was located; raises as an input's does."""
        ...

    def suit(self, samplerate: int, channels: int) -> None:
        """Be told the mix's rate, Hz, and the vibration's channels, before the first `keep`."""
        ...

    def refuse(self, actuators: Actuated) -> None:
        """Raise UsageError if what is there has no channels for these actuators."""
        ...

    def wire(self, actuators: Actuated) -> None:
        """Take these actuators from now on, which `refuse` let pass.

        Without a gap where as many go on, on channels that are open; else it is closed, for `keep`.
        """
        ...

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return for how long a frame is on its way after it was asked for, 0 if unknown."""
        ...

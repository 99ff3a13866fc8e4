"""What a connection to the sound server tells, to whom, and how long to wait for the next one."""

from __future__ import annotations

from dataclasses import dataclass

from device.errors import LostError
from device.server.snapshot import ServerSnapshot

DEFAULT_SETTLES_S = 0.2
"""How long the default sink must have stayed the same until that is told."""


@dataclass(frozen=True)
class Event:
    """Something of the server changed; number: counts the events of this connection, from 1.

    facility: "sink", "source", "sink_input", "source_output", "server" and others; kind: "new",
    "change" or "remove"; index: which one.
    """

    facility: str
    kind: str
    index: int
    number: int


class Listener:
    """What a `PulseConnection` tells; all methods do nothing here.

    The connection's own thread calls them: they must return at once, ask nothing of the
    connection, and not raise.
    """

    def on_event(self, event: Event) -> bool:
        """An event has come, this moment: nothing but its numbers is known yet.

        True asks for a snapshot at once; else one follows when the next ones have been gathered.
        """
        return False

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Everything was asked for again, after events."""

    def on_default_sink(self, name: str) -> None:
        """The default sink is another one, and has stayed it for DEFAULT_SETTLES_S; "": none."""

    def on_lost(self, error: LostError) -> None:
        """The server is gone: the last that this connection tells."""


def backoff_s(attempt: int) -> float:
    """How long to wait before attempt 1, 2, 3 ... of connecting again: 0.1 s, doubling to 2 s."""
    return float(min(0.1 * 2 ** min(max(attempt - 1, 0), 10), 2.0))

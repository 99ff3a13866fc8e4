"""Drop-in mode's hold on the default sink, and what a user chooses instead of it.

One thread at a time calls the methods; times are seconds of time.monotonic().
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from contextlib import suppress

from device.errors import NotFoundError
from device.server.forwarding import SINK, our_sink
from device.server.pulse import PulseConnection
from device.server.snapshot import ServerSnapshot

TAKES_S = 0.3
"""Servers and session managers have followed a new default sink by then; 50 ms are usual."""

_CONTESTS, _CONTEST_S = 5, 10.0
"""Who chooses other default sinks so often in so short a time is no user but a program."""


class DefaultSink:
    """Makes the virtual sink the default one and tells what was chosen instead.

    told: the default sink that has stayed the same for a while, as `Listener.on_default_sink` has
    it; any thread may set it. settled: whether the default sink is ours, and nothing is to be
    done. contested: another program wants it for itself, so that it was left alone.
    """

    def __init__(self, connection: PulseConnection, told: str) -> None:
        self.told = told
        self.settled = False
        self.contested = False
        self._connection = connection
        self._taken_s: float | None = None
        self._choices: deque[float] = deque(maxlen=_CONTESTS)

    def choice(self, snapshot: ServerSnapshot, now_s: float, fit: Collection[str]) -> str | None:
        """The sink that was made the default one since it was ours: told once.

        fit: what may be chosen; that has to stay chosen for a while, others are told at once.
        """
        default = snapshot.default_sink
        if default == SINK:
            self.settled, self.contested = True, False
        elif our_sink(snapshot) is None:
            self.settled = False  # the server chose another one, since ours is gone
        elif self.settled and default and (default == self.told or default not in fit):
            self.settled = False
            self._choices.append(now_s)
            often = len(self._choices) == _CONTESTS and now_s - self._choices[0] < _CONTEST_S
            self.contested = often
            return default
        return None

    def take(self, snapshot: ServerSnapshot, now_s: float) -> None:
        """Make the virtual sink the default one; again and again until it is.

        WirePlumber may not accept a sink that was only just made. LostError: the server is gone.
        """
        if self.settled or self.contested or snapshot.default_sink == SINK:
            return
        if self._taken_s is None or now_s - self._taken_s >= TAKES_S:
            self._taken_s = now_s
            with suppress(NotFoundError):
                self._connection.set_default_sink(SINK)

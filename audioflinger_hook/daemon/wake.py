"""What interrupts the main thread's rest: events, signals, sound."""

from __future__ import annotations

import os
import select
from types import TracebackType

from device.errors import LostError
from device.server import ServerSnapshot
from device.server.snapshot import Listener


class Wake:
    """A bell: `ring` from any thread or signal handler ends the next `wait`, or the present one.

    Rings do not add up. One thread waits; close it when nobody rings any more.
    """

    def __init__(self) -> None:
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._bell, select.POLLIN)

    def ring(self) -> None:
        """Wake who waits. Never blocks, takes no lock; after `close` it does nothing."""
        if self._bell >= 0:
            os.eventfd_write(self._bell, 1)

    def wait(self, limit_s: float) -> bool:
        """Wait until it rings, `limit_s` at most; whether it rang."""
        if not self._poll.poll(max(0.0, limit_s) * 1e3):
            return False
        os.eventfd_read(self._bell)
        return True

    def close(self) -> None:
        """Let go of the descriptor. Again too."""
        bell, self._bell = self._bell, -1
        if bell >= 0:
            os.close(bell)

    def __enter__(self) -> Wake:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class Nudge(Listener):
    """Wakes the supervising thread whenever the server has changed."""

    def __init__(self, wake: Wake) -> None:
        self._wake = wake

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Something is different."""
        self._wake.ring()

    def on_lost(self, error: LostError) -> None:
        """The server is gone."""
        self._wake.ring()

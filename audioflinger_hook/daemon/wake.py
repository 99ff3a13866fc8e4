"""Wakes the main thread for events, signals and sound."""

from __future__ import annotations

import os
import select


class Wake:
    """`ring`, from any thread or signal handler, ends the current or next `wait`.

    Several rings count as one. One thread waits, and calls `close` when no thread rings any more.
    """

    def __init__(self) -> None:
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._bell, select.POLLIN)

    def ring(self) -> None:
        """End a `wait`; never blocks and takes no lock. After `close` it does nothing."""
        if self._bell >= 0:
            os.eventfd_write(self._bell, 1)

    def wait(self, limit_s: float) -> bool:
        """Wait for a ring, at most `limit_s` seconds; return whether there was a ring."""
        if not self._poll.poll(max(0.0, limit_s) * 1e3):
            return False
        os.eventfd_read(self._bell)
        return True

    def close(self) -> None:
        """Close the descriptor. May be repeated."""
        bell, self._bell = self._bell, -1
        if bell >= 0:
            os.close(bell)

    def __enter__(self) -> Wake:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

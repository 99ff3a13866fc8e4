"""What systemd is told, over the socket it names; no library needed."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

from audioflinger_hook.service.one_line import one_line

PATIENCE_S = 0.2
"""Longest wait for room in systemd's queue."""


class Notifier:
    """Messages to the service manager; silent, and False from every method, where there is none.

    enabled: whether $NOTIFY_SOCKET names a socket: a path, or `@` and an abstract name. failures:
    messages that could not be sent. No method raises; each may take 0.2 s, so none is for the
    audio thread. Not to be used from two threads at once.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        name = environ.get("NOTIFY_SOCKET", "")
        self.enabled = len(name) > 1 and name[0] in "/@"
        # An abstract name begins with a null byte.
        address = os.fsencode(name)
        self._address = b"\0" + address[1:] if name.startswith("@") else address
        self.failures = 0

    def ready(self, status: str = "") -> bool:
        """Tell that the start, or a reload, is over; return whether it was sent."""
        return self._send("READY=1", *_status(status))

    def status(self, text: str) -> bool:
        """Tell what the daemon is doing, one line that `systemctl status` shows."""
        return self._send(*_status(text))

    def reloading(self, now_s: float) -> bool:
        """Tell that a reload begins; `now_s`: CLOCK_MONOTONIC. `ready` ends it."""
        return self._send("RELOADING=1", f"MONOTONIC_USEC={int(now_s * 1e6)}")

    def stopping(self, status: str = "") -> bool:
        """Tell that the daemon is ending."""
        return self._send("STOPPING=1", *_status(status))

    def watchdog(self) -> bool:
        """Tell that the daemon is well; see `Watchdog` for when."""
        return self._send("WATCHDOG=1")

    def _send(self, *assignments: str) -> bool:
        if not self.enabled:
            return False
        # A reason may hold what is no text elsewhere (a file's name in another encoding).
        message = "\n".join(assignments).encode("utf-8", "replace")
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.settimeout(PATIENCE_S)
                sender.sendto(message, socket.MSG_NOSIGNAL, self._address)
        except (OSError, ValueError):  # ValueError: a null byte in the path
            self.failures += 1
            return False
        return True


def _status(text: str) -> tuple[str, ...]:
    return (f"STATUS={one_line(text)}",) if text else ()

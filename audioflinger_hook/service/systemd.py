"""Messages to systemd, and the rule for its watchdog; needs no library."""

from __future__ import annotations

import math
import os
import socket
from collections.abc import Mapping

from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.state import DaemonState

SEND_TIMEOUT_S = 0.2  # longest wait for room in systemd's queue

CHECKS_PER_PERIOD = 4
"""The watchdog is fed after this part of its period, which leaves time for a late check."""


class Notifier:
    """Messages to the service manager at $NOTIFY_SOCKET, if it names a path or an abstract socket.

    A message may take 0.2 s, so audio threads must not send. Use from one thread at a time.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        name = environ.get("NOTIFY_SOCKET", "")
        self._enabled = len(name) > 1 and name[0] in "/@"
        # An abstract name begins with a null byte.
        address = os.fsencode(name)
        self._address = b"\0" + address[1:] if name.startswith("@") else address

    def send(self, *assignments: str, status: str = "") -> bool:
        """Send assignments and a status; return whether they were sent. Raises nothing."""
        if not self._enabled:
            return False
        if status:
            assignments = (*assignments, f"STATUS={one_line(status)}")
        # The text may contain a file name that is not valid UTF-8.
        message = "\n".join(assignments).encode("utf-8", "replace")
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.settimeout(SEND_TIMEOUT_S)
                sender.sendto(message, self._address)
        except (OSError, ValueError):  # ValueError: a null byte in the path
            return False
        return True


class Watchdog:
    """Decides when to feed systemd's watchdog: while sound flows, or has a reason not to flow.

    period_s: None for never. check_s: longest time between calls of `due`. One thread at a time.
    """

    def __init__(self, period_s: float | None) -> None:
        self.check_s = None if period_s is None else period_s / CHECKS_PER_PERIOD
        self._fed_s = -math.inf
        self._buffers = -1

    def due(self, buffers: int, state: DaemonState, now_s: float) -> bool:
        """Return whether to feed now, which the caller then does. buffers: count since the start.

        If it stays unchanged in state RUNNING, the daemon hangs.
        """
        if self.check_s is None or now_s - self._fed_s < self.check_s:
            return False
        if state is DaemonState.RUNNING and buffers == self._buffers:
            return False
        self._fed_s, self._buffers = now_s, buffers
        return True


def watchdog_period_s(pid: int, environ: Mapping[str, str] = os.environ) -> float | None:
    """Return $WATCHDOG_USEC in seconds, None if it is not set or $WATCHDOG_PID is not `pid`."""
    if environ.get("WATCHDOG_PID", str(pid)) != str(pid):
        return None
    text = environ.get("WATCHDOG_USEC", "")
    # Accept only ASCII digits, and no more than a time can have.
    if not (text.isascii() and text.isdigit() and len(text) < 20) or not int(text):
        return None
    return int(text) * 1e-6

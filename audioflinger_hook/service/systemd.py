"""Messages to systemd, and the timing of the messages to systemd's watchdog."""

import math
import os
import socket
from collections.abc import Mapping

from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.state import DaemonState

SEND_TIMEOUT_S = 0.2  # longest wait for space in systemd's queue


class Notifier:
    """Sends messages to the socket $NOTIFY_SOCKET, if set. A call may block for SEND_TIMEOUT_S."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        name = environ.get("NOTIFY_SOCKET", "")
        self._enabled = len(name) > 1 and name[0] in "/@"
        # An abstract name begins with a null byte.
        address = os.fsencode(name)
        self._address = b"\0" + address[1:] if name.startswith("@") else address

    def send(self, *assignments: str, status: str = "") -> bool:
        """Send NAME=VALUE pairs and a status text; return whether all were sent. Raises nothing."""
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
    """Timing of messages to systemd's watchdog.

    period_s: None disables the watchdog. check_s: longest interval between calls of `due`.
    """

    def __init__(self, period_s: float | None) -> None:
        self.check_s = None if period_s is None else period_s / 4  # one late check has no effect
        self._fed_s = -math.inf
        self._buffers = -1

    def due(self, buffers: int, state: DaemonState, now_s: float) -> bool:
        """Return whether to send a message now. now_s: seconds.

        buffers: number of processed buffers or frames. In the state RUNNING, the result is False
        if this number has not changed since the latest message.
        """
        if self.check_s is None or now_s - self._fed_s < self.check_s:
            return False
        if state is DaemonState.RUNNING and buffers == self._buffers:
            return False
        self._fed_s, self._buffers = now_s, buffers
        return True


def watchdog_period_s(pid: int, environ: Mapping[str, str] = os.environ) -> float | None:
    """Return $WATCHDOG_USEC in seconds; None if unset, invalid or not for process `pid`."""
    if environ.get("WATCHDOG_PID", str(pid)) != str(pid):
        return None
    text = environ.get("WATCHDOG_USEC", "")
    # Accept only ASCII digits, and no more digits than a 64-bit integer can have.
    if not (text.isascii() and text.isdigit() and len(text) < 20) or not int(text):
        return None
    return int(text) * 1e-6

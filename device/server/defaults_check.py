"""Detects a connection to PipeWire that reports outdated default devices.

PipeWire's PulseAudio server stores the default devices for each connection. A connection that is
made during a change of the defaults may report the old defaults until it is closed.
"""

import math
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from device.server.snapshot import ServerSnapshot, default_name

AFTER_S, AT_MOST_S = 1.0, 5.0  # a check is due 1 s after the last change, or 5 s after the first
RENEW_AGAIN_S = 30.0  # shortest time between two detections
AGAIN_S = 0.5  # time between two queries, in which a change in progress ends


class Defaults(NamedTuple):
    """Names of the default sink and the default source, "" for none."""

    sink: str
    source: str


class DefaultsCheck:
    """Compares a connection's defaults with those of new connections, if the server is PipeWire.

    disagreed: called on another thread, with the connection's defaults, if two new connections
    agree on other defaults. due_s: time.monotonic() of the next check, or None.
    """

    def __init__(self, disagreed: Callable[[Defaults], None]) -> None:
        self._disagreed = disagreed
        self._not_before_s = -math.inf
        self._changed_s: float | None = None  # the first change since the last check
        self.due_s: float | None = None

    def note_change(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Schedule a check after a new snapshot. now_s: time.monotonic()."""
        if snapshot.kind != "PipeWire":
            return
        if self._changed_s is None:
            self._changed_s = now_s
        settled_s = min(now_s + AFTER_S, self._changed_s + AT_MOST_S)
        self.due_s = max(settled_s, self._not_before_s)

    def check_if_due(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Start a check on another thread if a check is due."""
        if self.due_s is None or now_s < self.due_s:
            return
        self.due_s = self._changed_s = None
        known = Defaults(snapshot.default_sink, snapshot.default_source)

        def check() -> None:
            first = fetch_defaults()
            if first in (None, known):
                return
            time.sleep(AGAIN_S)
            if fetch_defaults() == first:
                self._not_before_s = time.monotonic() + RENEW_AGAIN_S
                self._disagreed(known)

        threading.Thread(target=check, name="defaults-check", daemon=True).start()


def fetch_defaults() -> Defaults | None:
    """Return the defaults of a new connection; None on failure. A hung server blocks the call."""
    import pulsectl

    try:
        with pulsectl.Pulse("haptic-cushion-asks") as pulse:
            info = pulse.server_info()
    except Exception:  # pulsectl has many exceptions for a lost server
        return None
    return Defaults(default_name(info.default_sink_name), default_name(info.default_source_name))

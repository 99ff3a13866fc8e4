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
RENEW_AGAIN_S, RENEW_AT_MOST_S = 2.0, 30.0
"""Shortest time between two detections; it doubles up to the second value until a check agrees."""

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
        self._renew_again_s = RENEW_AGAIN_S
        self._changed_s: float | None = None  # the first change since the last check
        self.due_s: float | None = None

    def note_change(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Schedule a check after a new snapshot. now_s: time.monotonic()."""
        if snapshot.kind != "PipeWire":
            return
        if self._changed_s is None:
            self._changed_s = now_s
        self.due_s = max(min(now_s + AFTER_S, self._changed_s + AT_MOST_S), self._not_before_s)

    def check_if_due(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Start a check on another thread if a check is due."""
        if self.due_s is None or now_s < self.due_s:
            return
        self.due_s = self._changed_s = None
        known = Defaults(snapshot.default_sink, snapshot.default_source)
        threading.Thread(
            target=self.check, args=(known,), name="defaults-check", daemon=True
        ).start()

    def check(self, known: Defaults) -> None:
        """Ask new connections until two agree, and report a disagreement with the known defaults.

        known: the connection's defaults. This blocks for a few seconds at most.
        """
        for _ in range(5):
            if (first := fetch_defaults()) == known:
                self._renew_again_s = RENEW_AGAIN_S
                return
            time.sleep(AGAIN_S)
            if first is not None and fetch_defaults() == first:
                self._not_before_s = time.monotonic() + self._renew_again_s
                self._renew_again_s = min(2.0 * self._renew_again_s, RENEW_AT_MOST_S)
                self._disagreed(known)
                return


def fetch_defaults() -> Defaults | None:
    """Return the defaults of a new connection; None on failure. A hung server blocks the call."""
    import pulsectl

    try:
        with pulsectl.Pulse("haptic-cushion-asks") as pulse:
            info = pulse.server_info()
    except Exception:  # pulsectl has many exceptions for a lost server
        return None
    return Defaults(default_name(info.default_sink_name), default_name(info.default_source_name))

"""Detects a connection to PipeWire that reports outdated default devices.

PipeWire's PulseAudio server keeps the default devices per connection. One connection in some
hundreds is made while they change, and reports the old ones from then on. Only another connection
shows that.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from device.server.snapshot import ServerSnapshot, default_name

AFTER_S = 1.0
"""The check comes this long after the last change."""

RENEW_AGAIN_S = 30.0
"""Least time between two detections."""

ANSWER_LIMIT_S = 1.0
AGAIN_S = 0.5
"""Time between two queries: a change in progress has reached both by then."""


class Defaults(NamedTuple):
    """Names of the default sink and the default source, "" for none."""

    sink: str
    source: str

    @classmethod
    def of(cls, snapshot: ServerSnapshot) -> Defaults:
        """Return those of a snapshot."""
        return cls(snapshot.default_sink, snapshot.default_source)


class DefaultsCheck:
    """Compares a connection's defaults with those of new connections, if the server is PipeWire.

    disagreed: called on another thread with the connection's defaults if two new connections
    report others. The connection's thread calls the methods. Times are seconds of
    time.monotonic(). due_s: when to call `check_if_due`; None for never.
    """

    def __init__(self, disagreed: Callable[[Defaults], None]) -> None:
        self._disagreed = disagreed
        self._not_before_s = -math.inf
        self.due_s: float | None = None

    def note_change(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Schedule a check after a change."""
        if snapshot.kind == "PipeWire":
            self.due_s = max(now_s + AFTER_S, self._not_before_s)

    def check_if_due(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Start a check on another thread if it is due."""
        if self.due_s is None or now_s < self.due_s:
            return
        self.due_s = None
        known = Defaults.of(snapshot)

        def check() -> None:
            if confirm_defaults(known) is not None:
                self._not_before_s = time.monotonic() + RENEW_AGAIN_S
                self._disagreed(known)

        threading.Thread(target=check, name="defaults-check", daemon=True).start()


def fetch_defaults() -> Defaults | None:
    """Return what a new connection reports; None without an answer in time.

    Any thread may call it; it waits at most 3 ANSWER_LIMIT_S and raises nothing.
    """
    import pulsectl

    def poll(descriptors: Sequence[Any], timeout_s: float) -> int:
        poller = select.poll()
        for item in descriptors:
            poller.register(item.fd, item.events)
        left_s = max(0.0, until_s - time.monotonic())
        wait_s = left_s if timeout_s < 0.0 else min(left_s, timeout_s)
        found = dict(poller.poll(1_000.0 * wait_s))
        for item in descriptors:
            item.revents = found.get(item.fd, 0)
        if not found and time.monotonic() >= until_s:
            pulse.close()
        return len(found)

    pulse = pulsectl.Pulse("haptic-cushion-asks", connect=False)
    until_s = time.monotonic() + 3.0 * ANSWER_LIMIT_S
    try:
        pulse.set_poll_func(poll, lambda *_: None)
        pulse.connect()
        info = pulse.server_info()
        return Defaults(
            default_name(info.default_sink_name), default_name(info.default_source_name)
        )
    except Exception:  # pulsectl has many exceptions for a lost server
        return None
    finally:
        with suppress(Exception):
            pulse.close()


def confirm_defaults(known: Defaults) -> Defaults | None:
    """Return what two new connections in turn report instead of `known`; None if they do not.

    Any thread may call it; it waits for both.
    """
    first = fetch_defaults()
    if first is None or first == known:
        return None
    time.sleep(AGAIN_S)
    return first if fetch_defaults() == first else None

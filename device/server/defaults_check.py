"""What another connection is told of the default devices.

PipeWire's server for PulseAudio's protocol keeps for each connection what the default devices are.
One in some hundreds is made while that changes, and then keeps being told what was before, on and
on, whatever is chosen later. Only another connection shows that.
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
"""Asked is when something has changed, and then nothing for so long."""

RENEW_AGAIN_S = 30.0
"""Between two times that a connection is found to be wrong."""

ANSWER_LIMIT_S = 1.0
AGAIN_S = 0.5
"""Between two that are asked: a change that is just being made has reached both by then."""


class Defaults(NamedTuple):
    """The names of the default sink and the default source, "" for none."""

    sink: str
    source: str

    @classmethod
    def of(cls, snapshot: ServerSnapshot) -> Defaults:
        """Those of a snapshot."""
        return cls(snapshot.default_sink, snapshot.default_source)


class DefaultsCheck:
    """Asks now and then whether a connection is told what others are told, if it is PipeWire's.

    server: its address, None for the usual one. disagreed: called on a thread of its own with what
    the connection was told, if two others were told something else. The connection's thread calls
    the methods; times are seconds of time.monotonic(). due_s: when `seek` is to be called, None
    for never.
    """

    def __init__(self, server: str | None, disagreed: Callable[[Defaults], None]) -> None:
        self._server = server
        self._disagreed = disagreed
        self._not_before_s = -math.inf
        self.due_s: float | None = None

    def changed(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Be told that something has changed."""
        if snapshot.kind == "PipeWire":
            self.due_s = max(now_s + AFTER_S, self._not_before_s)

    def seek(self, now_s: float, snapshot: ServerSnapshot) -> None:
        """Ask others, if that is due; it does not wait for them."""
        if self.due_s is None or now_s < self.due_s:
            return
        self.due_s = None
        known = Defaults.of(snapshot)

        def ask() -> None:
            if confirm_defaults(self._server, known) is not None:
                self._not_before_s = time.monotonic() + RENEW_AGAIN_S
                self._disagreed(known)

        threading.Thread(target=ask, name="second-opinion", daemon=True).start()


def fetch_defaults(server: str | None = None) -> Defaults | None:
    """What a connection made for it is told; None where there is no answer in time.

    server: its address, None for the usual one. Any thread; it waits ANSWER_LIMIT_S at most for
    each of three answers, and raises nothing.
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

    pulse = pulsectl.Pulse("haptic-cushion-asks", server=server, connect=False)
    until_s = time.monotonic() + 3.0 * ANSWER_LIMIT_S
    try:
        pulse.set_poll_func(poll, lambda *_: None)
        pulse.connect()
        info = pulse.server_info()
        return Defaults(
            default_name(info.default_sink_name), default_name(info.default_source_name)
        )
    except Exception:  # pulsectl's many ways to say that the server is gone
        return None
    finally:
        with suppress(Exception):
            pulse.close()


def confirm_defaults(server: str | None, known: Defaults) -> Defaults | None:
    """What two connections, one after the other, say other than `known`; None where they do not.

    Any thread; it waits for both.
    """
    first = fetch_defaults(server)
    if first is None or first == known:
        return None
    time.sleep(AGAIN_S)
    return first if fetch_defaults(server) == first else None

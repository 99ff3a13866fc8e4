"""When systemd's watchdog is fed: only while sound moves on, or has reason not to."""

from __future__ import annotations

import os
from collections.abc import Mapping

from audioflinger_hook.service.state import DaemonState

CHECKS_PER_PERIOD = 4
"""Fed when a quarter of the period has passed: a late check is still before half of it."""


def watchdog_period_s(pid: int, environ: Mapping[str, str] = os.environ) -> float | None:
    """Return after what silence systemd restarts process `pid`; None where it does not.

    From $WATCHDOG_USEC, unless $WATCHDOG_PID is another process.
    """
    if environ.get("WATCHDOG_PID", str(pid)) != str(pid):
        return None
    text = environ.get("WATCHDOG_USEC", "")
    # ASCII digits only, and few enough to be a time.
    if not (text.isascii() and text.isdigit() and len(text) < 20) or not int(text):
        return None
    return int(text) * 1e-6


class Watchdog:
    """Decides when to feed; whoever asks sends `WATCHDOG=1` and keeps the clock.

    period_s: of `watchdog_period_s`; None never feeds. Ask at least every `check_s` seconds.
    Not to be used from two threads at once.
    """

    def __init__(self, period_s: float | None) -> None:
        self.check_s = None if period_s is None else period_s / CHECKS_PER_PERIOD
        self._fed_s: float | None = None
        self._buffers: int | None = None

    def due(self, buffers: int, state: DaemonState, now_s: float) -> bool:
        """Return whether to feed now.

        buffers: how many have been played since the start; while the state is one in which
        sound must flow, a number that stands still is a daemon that hangs, and is not fed.
        """
        if self.check_s is None:
            return False
        if self._fed_s is not None and now_s - self._fed_s < self.check_s:
            return False
        if state.sound_must_flow and buffers == self._buffers:
            return False
        self._buffers = buffers
        self._fed_s = now_s
        return True

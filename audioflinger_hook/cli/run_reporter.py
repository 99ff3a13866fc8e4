"""Messages of a running daemon: lines on stderr for the user, and notifications for systemd."""

from __future__ import annotations

import math
import os
import re
import shutil
import sys
from collections.abc import Callable, Hashable

from audioflinger_hook.service.state import Note, StateReport
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_view import meter_line
from audioflinger_hook.service.systemd import Notifier
from device.errors import CushionError

AT_ONCE, EVERY_S = 5, 10.0  # messages of one kind without a pause, and average time between them
KINDS_MAX = 100  # largest number of kinds; all further kinds count as one
METER_S = 0.1  # time between two drawings of the meter


class RunReporter:
    """Reports each event once. For the main thread; times are seconds of time.monotonic()."""

    def __init__(self) -> None:
        self.notifier = Notifier()
        self._state = self._engine = self._page = ""
        self._has_meter = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._drawn_s = -math.inf
        self._warnings: dict[str, str] = {}
        self._rate_limit = RateLimit()

    def begin(self, tap: str, device: str) -> None:
        """Report tap and device, and that the start is complete."""
        self._print(f"sound of {tap} drives {device}; Ctrl+C ends it")
        self.notifier.send("READY=1")

    def report(
        self, report: StateReport, notes: list[Note], warnings: list[str], now_s: float
    ) -> None:
        """Report what has happened since the last call, and the new state."""
        state = f"{report.state.value}{': ' if report.reason else ''}{report.reason}"
        news = state != self._state
        for note in notes:
            if news and note.text == report.reason:
                continue  # the state line contains it
            left_out = self._rate_limit.left_out(note.cause, now_s)
            if left_out is not None:
                more = f" (and {left_out} more like it before)" if left_out else ""
                self._print(f"{note.cause.value}: {note.text}{more}")
        if news:
            self._state = state
            self.notifier.send(status=state)
            self._print(state)
        # A warning with a count is reported the first time, and by `end` with its final count.
        told, self._warnings = self._warnings, {}
        for warning in warnings:
            kind = re.sub(r"\d+", "0", warning)
            if kind not in told:
                self._print(f"warning: {warning}")
            self._warnings[kind] = told.get(kind, warning)

    def tell_engine(self, engine: str, reason: str) -> None:
        """Report a change of the playing engine, "" for none, and why it is not the native one."""
        text = f"the {engine} engine plays{': ' if reason else ''}{reason}"
        if engine and text != self._engine:
            self._engine = text
            self._print(text)

    def tell_page(self, address: str) -> None:
        """Report a page's address once; the part after `#`, which opens it, only to a terminal."""
        shown = address if sys.stderr.isatty() else address.partition("#")[0]
        if shown and shown != self._page:
            self._print(f"the live page: {shown}")
        self._page = shown

    def show_meter(self, status: Callable[[], Status], now_s: float) -> None:
        """Draw levels in the last line of a terminal, a few times a second; nothing elsewhere."""
        if self._has_meter and now_s - self._drawn_s >= METER_S:
            self._drawn_s = now_s
            width = shutil.get_terminal_size().columns - 1
            self._write(meter_line(status(), width))

    def reload(self, follow_config: Callable[[], str], now_s: float) -> str:
        """Reload the config and report the changes; return why it failed, or ""."""
        self.notifier.send("RELOADING=1", f"MONOTONIC_USEC={int(now_s * 1e6)}")
        config_error = ""
        try:
            self._print(f"config reloaded; changed: {follow_config()}")
        except CushionError as error:
            config_error = f"the config was not applied: {error}"
            # Reported as a warning, even if an equal warning was reported before.
            self._warnings = {k: text for k, text in self._warnings.items() if text != config_error}
        self.notifier.send("READY=1", status=self._state)
        return config_error

    def end(self, warnings: list[str]) -> None:
        """Report new warnings, and notify systemd of the end."""
        self.notifier.send("STOPPING=1")
        for warning in warnings:
            if warning not in self._warnings.values():
                self._print(f"warning: {warning}")
        self._write("")
        self._has_meter = False

    def _print(self, text: str) -> None:
        self._write(f"cushion: {text}\n")

    def _write(self, text: str) -> None:
        """Write in place of the meter. A closed terminal ends the run by its signal alone."""
        clear = "\r\x1b[K" if self._has_meter else ""
        try:
            print(f"{clear}{text}", end="", file=sys.stderr, flush=True)
        except OSError:
            self._has_meter = False


class RateLimit:
    """Limits how often messages of one kind are printed. Its size is bounded. One thread."""

    def __init__(self, at_once: float = AT_ONCE) -> None:
        self._at_once = at_once
        # Allowance, time of the last request, and messages left out since the last printed one.
        self._kinds: dict[Hashable, tuple[float, float, int]] = {}

    def left_out(self, kind: Hashable, now_s: float) -> int | None:
        """Return how many messages were left out before this one; None if this one is left out."""
        if kind not in self._kinds and len(self._kinds) >= KINDS_MAX:
            kind = None
        allowance, asked_s, missed = self._kinds.get(kind, (self._at_once, now_s, 0))
        allowance = min(self._at_once, allowance + max(0.0, now_s - asked_s) / EVERY_S)
        if allowance < 1.0:
            self._kinds[kind] = (allowance, now_s, missed + 1)
            return None
        self._kinds[kind] = (allowance - 1.0, now_s, 0)
        return missed

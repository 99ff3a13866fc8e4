"""Messages of a running daemon: lines on stderr for users, notifications for systemd."""

import math
import os
import re
import shutil
import sys
from collections.abc import Callable, Hashable

from audioflinger_hook.cli.status import meter_line
from audioflinger_hook.service.state import Note, StateReport
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.systemd import Notifier
from device.errors import CushionError

AT_ONCE, EVERY_S = 5, 10.0  # for each kind of message: largest burst, s per further message
KINDS_MAX = 100  # largest number of kinds of messages that are counted separately
METER_S = 0.1  # seconds between two drawings of the meter


class RunReporter:
    """Prints events. Only the main thread may use it. now_s: time of `time.monotonic()` in s."""

    def __init__(self) -> None:
        self.notifier = Notifier()
        self._state = self._engine = self._page = ""
        self._has_meter = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._drawn_s = -math.inf
        self._warnings: dict[str, str] = {}
        self._rate_limit = RateLimit()

    def begin(self, tap: str, device: str) -> None:
        """Print the tap and the device, and notify systemd that the start is complete."""
        self._print(f"sound of {tap} drives {device}; Ctrl+C ends it")
        self.notifier.send("READY=1")

    def report(
        self, report: StateReport, notes: list[Note], warnings: list[str], now_s: float
    ) -> None:
        """Print events and new warnings, and the state if it changed."""
        state = f"{report.state.value}{': ' if report.reason else ''}{report.reason}"
        news = state != self._state
        for note in notes:
            if news and note.text == report.reason:
                continue  # the state line contains this note
            left_out = self._rate_limit.left_out(note.cause, now_s)
            if left_out is not None:
                more = f" (and {left_out} more like it before)" if left_out else ""
                self._print(f"{note.cause.value}: {note.text}{more}")
        if news:
            self._state = state
            self.notifier.send(status=state)
            self._print(state)
        # A warning is not printed again if only a number changes. `end` prints the final text.
        told, self._warnings = self._warnings, {}
        for warning in warnings:
            kind = re.sub(r"\d+", "0", warning)
            if kind not in told:
                self._print(f"warning: {warning}")
            self._warnings[kind] = told.get(kind, warning)

    def tell_engine(self, engine: str, reason: str) -> None:
        """Print a change of engine. engine: "" for none. reason: why it is not "native"."""
        text = f"the {engine} engine plays{': ' if reason else ''}{reason}"
        if engine and text != self._engine:
            self._engine = text
            self._print(text)

    def tell_page(self, address: str) -> None:
        """Print a new page address."""
        if address and address != self._page:
            self._print(f"the live page: {address}")
        self._page = address

    def show_meter(self, status: Callable[[], Status], now_s: float) -> None:
        """Draw the level meter in the terminal's last line, at most once per METER_S."""
        if self._has_meter and now_s - self._drawn_s >= METER_S:
            self._drawn_s = now_s
            self._write(meter_line(status(), shutil.get_terminal_size().columns - 1))

    def reload(self, follow_config: Callable[[], str], now_s: float) -> str:
        """Reload the config and print the changes. Return the message of an error, or ""."""
        self.notifier.send("RELOADING=1", f"MONOTONIC_USEC={int(now_s * 1e6)}")
        config_error = ""
        try:
            self._print(f"config reloaded; changed: {follow_config()}")
        except CushionError as error:
            config_error = f"the config was not applied: {error}"
            # A repeated error is reported again.
            self._warnings = {k: text for k, text in self._warnings.items() if text != config_error}
        self.notifier.send("READY=1", status=self._state)
        return config_error

    def end(self, warnings: list[str]) -> None:
        """Print new and changed warnings, and notify systemd of the end."""
        self.notifier.send("STOPPING=1")
        for warning in warnings:
            if warning not in self._warnings.values():
                self._print(f"warning: {warning}")
        self._write("")
        self._has_meter = False

    def _print(self, text: str) -> None:
        self._write(f"cushion: {text}\n")

    def _write(self, text: str) -> None:
        """Print a text, which replaces the level meter. A write error does not end the run."""
        clear = "\r\x1b[K" if self._has_meter else ""
        try:
            print(f"{clear}{text}", end="", file=sys.stderr, flush=True)
        except OSError:
            self._has_meter = False


class RateLimit:
    """Limits how often messages of each kind are printed. Only one thread may use it."""

    def __init__(self, at_once: float = AT_ONCE) -> None:
        self._at_once = at_once
        # Values: allowance, time of the latest request in s, messages omitted since the last print.
        self._kinds: dict[Hashable, tuple[float, float, int]] = {}

    def left_out(self, kind: Hashable, now_s: float) -> int | None:
        """Return None to omit a message, else the number omitted since the last printed one."""
        if kind not in self._kinds and len(self._kinds) >= KINDS_MAX:
            kind = None
        allowance, asked_s, missed = self._kinds.get(kind, (self._at_once, now_s, 0))
        allowance = min(self._at_once, allowance + max(0.0, now_s - asked_s) / EVERY_S)
        if allowance < 1.0:
            self._kinds[kind] = (allowance, now_s, missed + 1)
            return None
        self._kinds[kind] = (allowance - 1.0, now_s, 0)
        return missed

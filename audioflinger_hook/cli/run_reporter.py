"""What a running daemon tells: its user on stderr, a line each, and systemd."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.service.rate_limit import RateLimit
from audioflinger_hook.service.state import Note, StateReport
from audioflinger_hook.service.systemd import Notifier
from device.errors import CushionError


class RunReporter:
    """Says what is new, once. Held by the main thread; times are seconds of time.monotonic().

    notifier: systemd's side.
    """

    def __init__(self) -> None:
        self.notifier = Notifier()
        self._state = ""
        self._warnings: dict[str, str] = {}
        self._rate_limit = RateLimit()

    def begin(self, tap: str, device: str) -> None:
        """Say what is tapped and where it plays, and that the start is over."""
        self._say(f"what plays at {tap} is felt at {device}; Ctrl+C ends it")
        self.notifier.ready()

    def tell(
        self, report: StateReport, notes: list[Note], warnings: list[str], now_s: float
    ) -> None:
        """Say what has happened since the last call, and what state that led to."""
        state = f"{report.state.value}{': ' if report.reason else ''}{report.reason}"
        news = state != self._state
        for note in notes:
            if news and note.text == report.reason:
                continue  # the state says it
            left_out = self._rate_limit.left_out(note.cause, now_s)
            if left_out is not None:
                more = f" (and {left_out} more like it before)" if left_out else ""
                self._say(f"{note.cause.value}: {note.text}{more}")
        if news:
            self._state = state
            self.notifier.status(state)
            self._say(state)
        # One that counts is told when it begins, and by `end` with what it came to.
        told, self._warnings = self._warnings, {}
        for warning in warnings:
            kind = re.sub(r"\d+", "0", warning)
            if kind not in told:
                warn(warning)
            self._warnings[kind] = told.get(kind, warning)

    def reload(self, follow_config: Callable[[float], str], now_s: float) -> str:
        """Let the config be read again and say what that changed, or why it changed nothing.

        Returns the latter, for the warnings, "" where all is well.
        """
        self.notifier.reloading(now_s)
        trouble = ""
        try:
            self._say(f"config read again; changed: {follow_config(now_s)}")
        except CushionError as error:
            trouble = f"the config was not taken: {error}"
            # Told as one of the warnings; again, even if it was one before.
            self._warnings = {k: text for k, text in self._warnings.items() if text != trouble}
        self.notifier.ready(self._state)
        return trouble

    def end(self, warnings: list[str]) -> None:
        """Say what is new among the warnings, and tell systemd that it ends."""
        self.notifier.stopping()
        for warning in warnings:
            if warning not in self._warnings.values():
                warn(warning)

    def _say(self, text: str) -> None:
        print(f"cushion: {text}", file=sys.stderr, flush=True)

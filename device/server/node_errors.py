"""How often PipeWire counts our nodes as late, as `pw-top` reports it.

The server keeps the counts, so a look now and then misses none. `pw-top` prints them from
PipeWire 1.0; before that it needs a terminal, and the counts stay unknown.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Collection
from contextlib import ExitStack
from typing import IO

from device.process import end, memory_file, started

COMMAND = ["pw-top", "--batch-mode", "--iterations=2"]  # the first listing has no counts yet
INTERVAL_S = 10.0  # time from one look to the next
ERRORS_COLUMN = 8  # of a listing: S ID QUANT RATE WAIT BUSY W/Q B/Q ERR FORMAT NAME


class NodeErrors:
    """The counts of some nodes, by name. One thread calls the methods; they raise nothing.

    process: the look that is under way, or None.
    """

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self._printed: IO[bytes]
        self._look = ExitStack()  # ends the process and closes its file
        self._due_s = -INTERVAL_S
        self._counts: dict[str, int] = {}
        self._may_ask = True

    def update(self, names: Collection[str], now_s: float) -> None:
        """Look if that is due. Never waits: a listing is read by a later call.

        names: of the nodes to look for. The count of one that has gone is kept.
        """
        if self.process is None:
            if self._may_ask and names and now_s - self._due_s >= INTERVAL_S:
                self._due_s = now_s
                self._ask()
        elif (code := self.process.poll()) is not None:
            self._may_ask = code == 0
            self._printed.seek(0)
            listing = self._printed.read().decode(errors="replace")
            self._counts.update(errors_in(listing, names))
            self.close()

    def count(self, suffix: str) -> int | None:
        """Return the errors of all nodes whose names end so, None while no count is known."""
        if not self._counts:
            return None
        return sum(count for name, count in self._counts.items() if name.endswith(suffix))

    def close(self) -> None:
        """End a look that is under way. May be repeated."""
        self.process = None
        self._look.close()

    def _ask(self) -> None:
        try:
            self._printed = self._look.enter_context(os.fdopen(memory_file("pw-top"), "r+b"))
            self.process = started(COMMAND, stdout=self._printed.fileno())
            self._look.callback(end, self.process)
        except OSError:
            self._may_ask = False
            self.close()


def errors_in(listing: str, names: Collection[str]) -> dict[str, int]:
    """Return the latest count of each of these nodes in what `pw-top` printed."""
    found: dict[str, int] = {}
    for line in listing.splitlines():
        words = line.split()
        if len(words) > ERRORS_COLUMN and words[-1] in names and words[ERRORS_COLUMN].isdecimal():
            found[words[-1]] = int(words[ERRORS_COLUMN])
    return found

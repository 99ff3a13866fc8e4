"""PipeWire's counts of processing cycles in which our nodes were late, from `pw-top`.

The server adds up the counts, so rare readings are enough. Before PipeWire 1.0, `pw-top` needs a
terminal, so the counts stay unknown.
"""

import os
import subprocess
from collections.abc import Collection
from contextlib import ExitStack
from typing import IO

from device.process import end, memory_file, started

COMMAND = ["pw-top", "--batch-mode", "--iterations=2"]  # the first listing has no counts yet
INTERVAL_S = 10.0  # time between two readings
ERRORS_COLUMN = 8  # index of ERR in: S ID QUANT RATE WAIT BUSY W/Q B/Q ERR FORMAT NAME


class NodeErrors:
    """Counts of late cycles by node. Only one thread may call the methods; they raise nothing."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None  # the running `pw-top`
        self._printed: IO[bytes]
        self._look = ExitStack()  # ends the process and closes its file
        self._due_s = -INTERVAL_S
        self._counts: dict[str, int] = {}
        self._may_ask = True

    def update(self, names: Collection[str], now_s: float) -> None:
        """Start `pw-top` for these nodes if that is due, or read its result. Never waits."""
        if self.process is None:
            if self._may_ask and names and now_s - self._due_s >= INTERVAL_S:
                self._due_s = now_s
                try:
                    memory = os.fdopen(memory_file("pw-top"), "r+b")
                    self._printed = self._look.enter_context(memory)
                    self.process = started(COMMAND, stdout=self._printed.fileno())
                    self._look.callback(end, self.process)
                except OSError:
                    self._may_ask = False
                    self.close()
        elif (code := self.process.poll()) is not None:
            self._may_ask = code == 0
            self._printed.seek(0)
            self._counts.update(errors_in(self._printed.read().decode(errors="replace"), names))
            self.close()

    def count(self, suffix: str) -> int | None:
        """Return the sum of the counts of nodes whose names end in suffix; None if unknown."""
        if not self._counts:
            return None
        return sum(count for name, count in self._counts.items() if name.endswith(suffix))

    def close(self) -> None:
        """End a running `pw-top`. May be repeated."""
        self.process = None
        self._look.close()


def errors_in(listing: str, names: Collection[str]) -> dict[str, int]:
    """Return the latest error count of each node in `names`, from the output of `pw-top`."""
    found: dict[str, int] = {}
    for line in listing.splitlines():
        words = line.split()
        if len(words) > ERRORS_COLUMN and words[-1] in names and words[ERRORS_COLUMN].isdecimal():
            found[words[-1]] = int(words[ERRORS_COLUMN])
    return found

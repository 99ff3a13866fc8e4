"""How often PipeWire counts our nodes as late, as `pw-top` reports it.

The server keeps the counts, so a look now and then misses none. `pw-top` prints them from
PipeWire 1.0; before that it needs a terminal, and the counts stay unknown.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Collection
from contextlib import suppress

from device.process import end, started

PROGRAM = "pw-top"
COMMAND = [PROGRAM, "--batch-mode", "--iterations=2"]
"""The first listing has no counts yet. Two take a second."""

INTERVAL_S = 10.0  # time from one look to the next

ERRORS_COLUMN = 8  # of a listing: S ID QUANT RATE WAIT BUSY W/Q B/Q ERR FORMAT NAME


class NodeErrors:
    """The counts of some nodes, by name. One thread calls the methods; they raise nothing."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._printed = b""
        self._due_s = -INTERVAL_S
        self._counts: dict[str, int] = {}
        self._may_ask = True

    def update(self, names: Collection[str], now_s: float) -> None:
        """Look if that is due. Never waits: a listing is read by a later call.

        names: of the nodes to look for. The count of one that has gone is kept.
        """
        if self._process is not None:
            self._read(names)
        elif self._may_ask and names and now_s - self._due_s >= INTERVAL_S:
            self._due_s = now_s
            self._ask()

    def count(self, suffix: str) -> int | None:
        """Return the errors of all nodes whose names end so, None while no count is known."""
        if not self._counts:
            return None
        return sum(count for name, count in self._counts.items() if name.endswith(suffix))

    @property
    def is_looking(self) -> bool:
        """Whether a look is under way."""
        return self._process is not None

    def close(self) -> None:
        """End a look that is under way. May be repeated."""
        process, self._process = self._process, None
        self._printed = b""
        if process is not None:
            end(process)

    def _ask(self) -> None:
        try:
            self._process = started(COMMAND, stdout=subprocess.PIPE)
        except OSError:
            self._may_ask = False
            return
        assert self._process.stdout is not None
        os.set_blocking(self._process.stdout.fileno(), False)

    def _read(self, names: Collection[str]) -> None:
        process = self._process
        assert process is not None
        assert process.stdout is not None
        code = process.poll()  # before reading, so that nothing can follow what is read
        with suppress(BlockingIOError):
            while block := os.read(process.stdout.fileno(), 1 << 16):
                self._printed += block
        if code is None:
            return
        self._counts.update(errors_in(self._printed.decode(errors="replace"), names))
        self._may_ask = code == 0
        self.close()


def errors_in(listing: str, names: Collection[str]) -> dict[str, int]:
    """Return the latest count of each of these nodes in what `pw-top` printed."""
    found: dict[str, int] = {}
    for line in listing.splitlines():
        words = line.split()
        if len(words) > ERRORS_COLUMN and words[-1] in names and words[ERRORS_COLUMN].isdecimal():
            found[words[-1]] = int(words[ERRORS_COLUMN])
    return found

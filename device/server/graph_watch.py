"""Follows PipeWire's graph and keeps our links in it.

`pw-dump --monitor` reports every change, so nothing is polled. One `pw-cli` that stays open makes
and removes links within a millisecond; they belong to it, so they vanish with the program, however
that ends.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from device.errors import NotFoundError
from device.process import started
from device.server.graph import Graph
from device.server.link_keeper import LinkKeeper

READER, EDITOR = "pw-dump", "pw-cli"
"""Programs of PipeWire that report and change the graph."""

READ_BYTES = 1 << 20
GATHER_S = 0.1
"""Changes are reported at once, and again after so long."""

SOON_S = 0.001
"""`pw-dump` writes line by line, hundreds for one change; each read waits for more of them."""

BUSY_READS, BUSY_S, BUSY_WAIT_S = 100, 1.0, 0.005
"""After so many reads in so long, each one waits longer."""

END_S = 0.5
"""Longest wait for the thread's end."""


class GraphWatch:
    """The graph as it is now, and the links that are wanted in it.

    One thread makes it and calls the methods. Hold `lock` while `graph` or `keeper` is used.

    on_change: called by the thread of this object after changes, a few together; it must return at
    once. Links do not wait for it.
    lost: whether the connection is gone; make another object to connect again.
    NotFoundError: a program of PipeWire is not installed.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.lock = threading.RLock()
        self.graph = Graph()
        self.lost = False
        self._on_change = on_change
        self._process = _started(
            [READER, "--monitor", "--no-colors"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
        )
        self._editor = Editor()
        self.keeper = LinkKeeper(self.graph, self._editor.send)
        self._thread = threading.Thread(target=self._follow, name="graph", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the connection; our links vanish. May be repeated; raises nothing."""
        self._process.kill()
        self._process.wait()
        self._thread.join(END_S)
        if self._process.stdout:
            self._process.stdout.close()
        self._editor.close()

    def _follow(self) -> None:
        assert self._process.stdout is not None
        reported_s, waits = -GATHER_S, False
        with suppress(ValueError, OSError):
            documents = Documents(self._process.stdout.fileno())
            while not documents.ended:
                now_s = time.monotonic()
                wait_s = max(0.0, reported_s + GATHER_S - now_s) if waits else None
                if found := documents.read(wait_s):
                    waits = True
                    with self.lock:
                        wired = [self.graph.apply(document) for document in found]
                        if any(wired):
                            self.keeper.update(time.monotonic())
                now_s = time.monotonic()
                if waits and now_s - reported_s >= GATHER_S:
                    reported_s, waits = now_s, False
                    self._on_change()
        self.lost = True
        self._on_change()


class Editor:
    """One running `pw-cli`, started again if it has ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    def send(self, command: str) -> None:
        """Send one command. Never waits and raises nothing: a lost command is sent again later."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            with suppress(NotFoundError):
                self._start()
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                os.write(self._process.stdin.fileno(), f"{command}\n".encode())

    def restart(self) -> None:
        """Replace a program that does not answer; links that it made vanish."""
        self.close()

    def close(self) -> None:
        """End it, and with it all links that it made. May be repeated; raises nothing."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            if process.stdin is not None:
                with suppress(OSError):
                    process.stdin.close()

    def _start(self) -> None:
        self._process = _started([EDITOR], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)


def _started(command: list[str], *, stdin: int, stdout: int) -> subprocess.Popen[bytes]:
    try:
        return started(command, stdin=stdin, stdout=stdout)
    except OSError as error:
        raise NotFoundError(
            f"{command[0]} cannot be run ({error.strerror}); install pipewire-bin"
        ) from None


class Documents:
    """The JSON arrays that `pw-dump` writes to a file. ended: whether there are no more."""

    def __init__(self, file: int) -> None:
        self._file = file
        with suppress(OSError):  # a full pipe would make `pw-dump` wait
            fcntl.fcntl(file, fcntl.F_SETPIPE_SZ, READ_BYTES)
        self._waiting = b""
        self._reads_s = deque([-BUSY_S], maxlen=BUSY_READS)
        self._poll = select.poll()
        self._poll.register(file, select.POLLIN)
        self.ended = False

    def read(self, wait_s: float | None) -> list[Any]:
        """Return all arrays that have arrived, after waiting for more at most so long.

        Each begins and ends with a line of its own, and only its brackets are in the first column.
        """
        if not self._poll.poll(None if wait_s is None else 1e3 * wait_s):
            return []
        now_s = time.monotonic()
        time.sleep(BUSY_WAIT_S if now_s - self._reads_s[0] < BUSY_S else SOON_S)
        self._reads_s.append(now_s)
        block = os.read(self._file, READ_BYTES)
        self.ended = not block
        *whole, self._waiting = (self._waiting + block).split(b"\n]\n")
        return [json.loads(text + b"\n]") for text in whole]

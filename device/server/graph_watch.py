"""Follows PipeWire's graph and keeps our links in it.

`pw-dump --monitor` reports every change, so nothing is polled. One `pw-cli` that stays open makes
and removes links within a millisecond, and announces new objects. Links belong to it, so they
vanish with the program, however that ends.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import re
import select
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from device.errors import NotFoundError
from device.process import end, started
from device.server.graph import LINK_ENDS, Graph
from device.server.link_keeper import LinkKeeper

READER, EDITOR = "pw-dump", "pw-cli"  # programs of PipeWire that report and change the graph

PIPE_BYTES, READ_BYTES = 1 << 20, 1 << 16
LONGEST_LINE_BYTES = 1 << 14  # of a longer line the rest is dropped; names may have any length
GATHER_S = 0.2  # changes are reported at once, and again after so long
DESCRIBED_S = 0.001  # time for more to arrive: `pw-dump` writes hundreds of lines for one change

BUSY_READS, BUSY_S, BUSY_WAIT_S = 250, 5.0, 0.02
"""After so many reads in so long, each one waits longer. A stream that comes and goes takes 25."""

END_S = 0.5  # longest wait for the thread's end


class GraphWatch:
    """The present graph, and the wanted links in it. For one thread.

    Hold `lock` while `graph` or `keeper` is used.

    on_change: called by the thread of this object after changes, a few together; it must return at
    once. lost: whether the connection is gone; make another object then.
    NotFoundError: a program of PipeWire is not installed.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.lock = threading.RLock()
        self.graph = Graph()
        self.lost = False
        self._on_change = on_change
        self._editor = Editor()
        try:
            command = [READER, "--monitor", "--no-colors"]
            self._process = _started(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
        except NotFoundError:
            self._editor.close()
            raise
        self.keeper = LinkKeeper(self.graph, self._editor.send)
        self._thread = threading.Thread(target=self._follow, name="graph", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the connection; our links vanish. May be repeated; raises nothing."""
        self._process.kill()
        self._thread.join(END_S)  # it reads until the program has ended
        end(self._process)
        self._editor.close()

    def _follow(self) -> None:
        assert self._process.stdout is not None
        reported_s, changed = -GATHER_S, False
        with suppress(ValueError, OSError):
            documents = Documents(self._process.stdout.fileno())
            announcements = Announcements(self._editor.printed)
            arrivals = Arrivals(documents.file, announcements.file)
            while not documents.ended:
                ready = arrivals.wait(reported_s + GATHER_S if changed else math.inf)
                new = announcements.read() if announcements.file in ready else []
                found = documents.read() if documents.file in ready else []
                now_s = time.monotonic()
                if new or found:
                    changed = True
                    with self.lock:
                        wired = [self.graph.announce(new), *map(self.graph.apply, found)]
                        if any(wired):
                            self.keeper.update(now_s)
                if changed and now_s - reported_s >= GATHER_S:
                    reported_s, changed = now_s, False
                    self._on_change()
        self.lost = True
        self._on_change()


class Arrivals:
    """When to read the two files: descriptions wait for more, and both in a busy graph."""

    def __init__(self, described: int, announced: int) -> None:
        self._either, self._announced = select.poll(), select.poll()
        self._either.register(described, select.POLLIN)
        for poll in (self._either, self._announced):
            poll.register(announced, select.POLLIN)
        self._reads_s = deque([-BUSY_S], maxlen=BUSY_READS)

    def wait(self, until_s: float) -> set[int]:
        """Return the files to read now; none if nothing arrives until then."""
        now_s = time.monotonic()
        wait_ms = None if until_s == math.inf else max(0.0, 1e3 * (until_s - now_s))
        ready = {file for file, _ in self._either.poll(wait_ms)}
        now_s = time.monotonic()
        if ready and now_s - self._reads_s[0] < BUSY_S:
            time.sleep(BUSY_WAIT_S)
            ready = {file for file, _ in self._either.poll(0)}
        elif ready and (first := self._announced.poll(1e3 * DESCRIBED_S)):
            ready = {file for file, _ in first}  # a link does not wait for long descriptions
        if ready:
            self._reads_s.append(now_s)
        return ready


class Editor:
    """One running `pw-cli`, started again if it has ended. printed: file of its announcements."""

    def __init__(self) -> None:
        self.printed, self._output = os.pipe()
        try:
            self._process = self._start()
        except NotFoundError:
            self._close_pipe()
            raise

    def send(self, command: str) -> None:
        """Send one command. Never waits and raises nothing: a lost command is sent again later."""
        if self._process.poll() is not None:
            end(self._process)
            with suppress(NotFoundError):
                self._process = self._start()
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # it has ended
            os.write(self._process.stdin.fileno(), f"{command}\n".encode())

    def close(self) -> None:
        """End it, and with it all links that it made. May be repeated; raises nothing."""
        end(self._process)
        self._close_pipe()

    def _close_pipe(self) -> None:
        for file in (self.printed, self._output):
            with suppress(OSError):
                os.close(file)
        self.printed = self._output = -1

    def _start(self) -> subprocess.Popen[bytes]:
        process = _started([EDITOR, "--monitor"], stdin=subprocess.PIPE, stdout=self._output)
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), False)
        return process


def _started(command: list[str], *, stdin: int, stdout: int) -> subprocess.Popen[bytes]:
    try:
        return started(command, stdin=stdin, stdout=stdout)
    except OSError as error:
        raise NotFoundError(
            f"{command[0]} cannot be run ({error.strerror}); install pipewire-bin"
        ) from None


class Documents:
    """The JSON arrays that `pw-dump` writes to the file. ended: whether there are no more."""

    def __init__(self, file: int) -> None:
        self.file = file
        with suppress(OSError):  # a full pipe would make `pw-dump` wait
            fcntl.fcntl(file, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._waiting = b""
        self.ended = False

    def read(self) -> list[Any]:
        """Return all arrays that have arrived; waits until something is there.

        Each begins and ends with a separate line; only its brackets are in the first column.
        """
        block = os.read(self.file, READ_BYTES)
        self.ended = not block
        *whole, self._waiting = (self._waiting + block).split(b"\n]\n")
        return [json.loads(_PARAMETERS.sub(b"", text) + b"\n]") for text in whole]


_PARAMETERS = re.compile(rb'(?<=\n      "params": \{).*?(?=\n      \})', re.DOTALL)
"""Formats and volumes of nodes: most of the text, and not used."""


_ADDED = re.compile(r"remote \d+ added global: \tid (\d+), type ([\w:]+)/\d+")
_REMOVED = re.compile(r"remote \d+ removed global: \tid (\d+)")
_PROPERTY = re.compile(r'\s*\*?\s*([\w.-]+) = "(.*)"')
_KINDS = (":Core", ":Node", ":Port", ":Link")
_ENDS = {"link." + end.removesuffix("-id").replace("-", "."): end for end in LINK_ENDS}


class Announcements:
    """The objects that `pw-cli --monitor` prints to the file, milliseconds before `pw-dump`.

    `pw-dump` describes an object once it knows all of it. The two ends of a link come at once here,
    which is enough to mirror it before its first cycle.
    """

    def __init__(self, file: int) -> None:
        self.file = file
        self._line = b""
        self._object: dict[str, Any] | None = None

    def read(self) -> list[dict[str, Any]]:
        """Return objects in the form of `pw-dump`, as far as known; one that is gone has no `info`.

        A link comes as soon as its ends are known, others with the next line that is not theirs.
        Waits until something is there; raises nothing.
        """
        try:
            block = os.read(self.file, READ_BYTES)
        except OSError:
            return []
        *lines, self._line = (self._line + block).split(b"\n")
        self._line = self._line[:LONGEST_LINE_BYTES]
        found: list[dict[str, Any]] = []
        for line in lines:
            self._take(line.decode(errors="replace"), found)
        return found

    def _take(self, line: str, found: list[dict[str, Any]]) -> None:
        item = self._object
        if line.startswith("remote "):
            if item is not None and not item["type"].endswith(":Link"):
                found.append(item)
            self._object = None
            if (added := _ADDED.match(line)) and added[2].endswith(_KINDS):
                self._object = {"id": int(added[1]), "type": added[2], "info": {"props": {}}}
            elif removed := _REMOVED.match(line):
                found.append({"id": int(removed[1]), "info": None})
        elif item is not None and (known := _PROPERTY.match(line)):
            name, value = known.groups()
            info = item["info"]
            info["props"][name] = value
            if name in _ENDS:
                info[_ENDS[name]] = value
                if info.keys() >= set(LINK_ENDS):
                    found.append(item)
                    self._object = None

"""Follows PipeWire's graph and keeps our links in it.

`pw-dump --monitor` reports every change, so nothing is polled. One running `pw-cli` makes and
removes links, and announces new objects. The links vanish when this program ends, because they
belong to the `pw-cli` process, which then ends too.
"""

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
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from device.errors import NotFoundError
from device.process import end, started
from device.server.graph import LINK_ENDS, Graph
from device.server.link_keeper import LinkKeeper

READER, EDITOR = "pw-dump", "pw-cli"  # programs of PipeWire that report and change the graph
PIPE_BYTES, READ_BYTES = 1 << 20, 1 << 16
LONGEST_LINE_BYTES = 1 << 14  # longer lines are truncated, since names may have any length
GATHER_S = 0.2  # shortest time between two reports of changes
DESCRIBED_S = 0.001  # longest wait for an announcement before a longer description is read

# After BUSY_READS reads within BUSY_S, each read waits BUSY_WAIT_S longer.
BUSY_READS, BUSY_S, BUSY_WAIT_S = 250, 5.0, 0.02

END_S = 0.5  # longest wait for the thread's end


class GraphWatch:
    """Keeps `graph` up to date, and makes the wanted links. Only one thread may use the object.

    Hold `lock` while you use `graph` or `keeper`. on_change: called by this object's thread after
    one or more changes; it must return at once. lost: whether the connection is lost; make a new
    object after a loss. NotFoundError: a program of PipeWire is not installed.
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
        """End the connection, which removes our links. May be repeated; raises nothing."""
        self._process.kill()
        self._thread.join(END_S)  # the thread reads until `pw-dump` has ended
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
                        if any([self.graph.announce(new), *map(self.graph.apply, found)]):
                            self.keeper.update(now_s)
                if changed and now_s - reported_s >= GATHER_S:
                    reported_s, changed = now_s, False
                    self._on_change()
        self.lost = True
        self._on_change()


class Arrivals:
    """Selects the file to read: announcements of `pw-cli` have priority over `pw-dump`."""

    def __init__(self, described: int, announced: int) -> None:
        self._either, self._announced = select.poll(), select.poll()
        self._either.register(described, select.POLLIN)
        for poll in (self._either, self._announced):
            poll.register(announced, select.POLLIN)
        self._reads_s = deque([-BUSY_S], maxlen=BUSY_READS)

    def wait(self, until_s: float) -> set[int]:
        """Return the files to read now; an empty set if nothing arrives before until_s."""
        now_s = time.monotonic()
        wait_ms = None if until_s == math.inf else max(0.0, 1e3 * (until_s - now_s))
        ready = {file for file, _ in self._either.poll(wait_ms)}
        now_s = time.monotonic()
        if ready and now_s - self._reads_s[0] < BUSY_S:
            time.sleep(BUSY_WAIT_S)
            ready = {file for file, _ in self._either.poll(0)}
        elif ready and (first := self._announced.poll(1e3 * DESCRIBED_S)):
            ready = {file for file, _ in first}  # a new link must not wait for long descriptions
        if ready:
            self._reads_s.append(now_s)
        return ready


class Editor:
    """A running `pw-cli`; `send` restarts it if it has ended. printed: read end of its output."""

    def __init__(self) -> None:
        self.printed, self._output = os.pipe()
        try:
            self._process = self._start()
        except NotFoundError:
            self._close_pipe()
            raise

    def send(self, command: str) -> None:
        """Send one command. This never waits or raises; the caller must repeat a lost command."""
        if self._process.poll() is not None:
            end(self._process)
            with suppress(NotFoundError):
                self._process = self._start()
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # `pw-cli` has ended
            os.write(self._process.stdin.fileno(), f"{command}\n".encode())

    def close(self) -> None:
        """End `pw-cli`, which removes its links. May be repeated; raises nothing."""
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
    """Reads the JSON arrays that `pw-dump` prints. ended: whether no more output will come."""

    def __init__(self, file: int) -> None:
        self.file = file
        with suppress(OSError):  # `pw-dump` would wait while the pipe is full
            fcntl.fcntl(file, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._waiting = b""
        self.ended = False

    def read(self) -> list[Any]:
        """Wait until the file has content; return the arrays that are complete."""
        block = os.read(self.file, READ_BYTES)
        self.ended = not block
        *whole, self._waiting = (self._waiting + block).split(b"\n]\n")
        texts = (_PARAMETERS.sub(_latency_in, text) + b"\n]" for text in whole)
        return [json.loads(text.decode(errors="replace")) for text in texts]


# Formats and volumes of nodes are most of the text. Only the latencies in it are used.
_PARAMETERS = re.compile(rb'(?<=\n      "params": \{)(?:\n        .*)+')
_LATENCY = re.compile(rb'\n        "Latency": \[(?:\n          .*)*\n        \]')


def _latency_in(parameters: re.Match[bytes]) -> bytes:
    found = _LATENCY.search(parameters[0])
    return found[0] if found else b""


_ADDED = re.compile(r"remote \d+ added global: \tid (\d+), type ([\w:]+)/\d+")
_REMOVED = re.compile(r"remote \d+ removed global: \tid (\d+)")
_PROPERTY = re.compile(r'\s*\*?\s*([\w.-]+) = "(.*)"')
_KINDS = (":Core", ":Node", ":Port", ":Link")
_ENDS = {"link." + end.removesuffix("-id").replace("-", "."): end for end in LINK_ENDS}


class Announcements:
    """Reads the objects that `pw-cli --monitor` prints, sooner than `pw-dump` prints them.

    `pw-dump` waits for all properties of an object. `pw-cli` prints both ends of a link at once.
    """

    def __init__(self, file: int) -> None:
        self.file = file
        self._line = b""
        self._object: dict[str, Any] | None = None

    def read(self) -> list[dict[str, Any]]:
        """Wait for content; return new and removed objects, in the form of `pw-dump`.

        For a removed object, `info` is None. A link is returned as soon as both its ends are known,
        any other object when the next announcement begins. Never raises.
        """
        try:
            block = os.read(self.file, READ_BYTES)
        except OSError:
            return []
        *lines, self._line = (self._line + block).split(b"\n")
        self._line = self._line[:LONGEST_LINE_BYTES]
        return [one for line in lines for one in self._take(line.decode(errors="replace"))]

    def _take(self, line: str) -> Iterator[dict[str, Any]]:
        item = self._object
        if line.startswith("remote "):
            if item is not None and not item["type"].endswith(":Link"):
                yield item
            self._object = None
            if (added := _ADDED.match(line)) and added[2].endswith(_KINDS):
                self._object = {"id": int(added[1]), "type": added[2], "info": {"props": {}}}
            elif removed := _REMOVED.match(line):
                yield {"id": int(removed[1]), "info": None}
        elif item is not None and (known := _PROPERTY.match(line)):
            name, value = known.groups()
            info = item["info"]
            info["props"][name] = value
            if name in _ENDS:
                info[_ENDS[name]] = value
                if info.keys() >= set(LINK_ENDS):
                    yield item
                    self._object = None

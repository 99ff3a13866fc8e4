"""PipeWire's graph: which ports there are, how they are linked, and links that we make.

`pw-link --monitor` reports every change, so nothing is polled. A link belongs to the ports that it
joins: when one of them vanishes, the link vanishes, and the server makes no other one. So a stream
that nothing else links can never play to another device.
"""

from __future__ import annotations

import re
import subprocess
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import product

from device.errors import NotFoundError
from device.process import ends_with_us

PROGRAM = "pw-link"
ANSWER_S = 0.5
"""Longest time that one request may take; one that hangs is made again."""

RETRY_S = 0.1
"""Time between two equal requests."""

_LINE = re.compile(r"([=+-])\s+(\d+)\s+(.*\S)\s*$")
_JOINS = " -> "

Link = tuple[str, str]
"""An output port and an input port, as NODE:PORT."""


class Graph:
    """Ports and links of the graph, kept up to date by a thread.

    The thread that makes it calls the methods; any thread may read `ports`, `links` and `lost`.

    on_change: called by the thread of this object after each change; must return at once.
    ports: names of all ports, as NODE:PORT. links: all links. lost: whether the graph is gone; make
    another object to connect again.
    NotFoundError: `pw-link` is not installed.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.ports: frozenset[str] = frozenset()
        self.links: frozenset[Link] = frozenset()
        self.lost = False
        self._on_change = on_change
        self._known: dict[str, str | Link] = {}
        self._requests: dict[tuple[str, ...], tuple[subprocess.Popen[bytes], float]] = {}
        self._asked_s: dict[tuple[str, ...], float] = {}
        try:
            self._process = subprocess.Popen(
                [PROGRAM, "--monitor", "--output", "--input", "--links", "--id"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                errors="replace",
                preexec_fn=ends_with_us,
                process_group=0,  # signals of the terminal are the daemon's
            )
        except OSError as error:
            raise NotFoundError(
                f"{PROGRAM} cannot be run ({error.strerror}); install pipewire-bin"
            ) from None
        self._thread = threading.Thread(target=self._read, name="graph", daemon=True)
        self._thread.start()

    def ports_of(self, node: str, prefix: str) -> frozenset[str]:
        """Return a node's ports whose names begin with a prefix, such as "playback_"."""
        start = f"{node}:{prefix}"
        return frozenset(port for port in self.ports if port.startswith(start))

    def ensure(self, wanted: Iterable[Link], nodes: Iterable[str], now_s: float) -> None:
        """Ask for exactly these links of nodes. Does not wait: a later call shows the result.

        Streams of one program may have equal names: all ports of a name are linked.

        nodes: whose other links are removed.
        """
        self._reap(now_s)
        wanted, known = set(wanted), dict(self._known)
        starts = tuple(f"{node}:" for node in nodes)
        ids: dict[str, list[str]] = {}
        made = Counter(item for item in known.values() if isinstance(item, tuple))
        for number, item in known.items():
            if isinstance(item, str):
                ids.setdefault(item, []).append(number)
            elif item not in wanted and any(port.startswith(starts) for port in item):
                self.remove((number,), now_s)
        for link in wanted:
            outputs, inputs = (ids.get(port, []) for port in link)
            if made[link] < len(outputs) * len(inputs):
                for pair in product(outputs, inputs):
                    self._request(("--passive", *pair), now_s)

    def remove(self, links: Iterable[str], now_s: float) -> None:
        """Ask to remove links by their numbers; `ensure` makes them again."""
        for number in links:
            self._request(("--disconnect", number), now_s)

    def close(self) -> None:
        """Stop watching; links stay. May be repeated; raises nothing."""
        self._process.kill()
        self._process.wait()
        self._thread.join(ANSWER_S)
        if self._process.stdout:
            self._process.stdout.close()
        for request, _ in self._requests.values():
            request.kill()
            request.wait()
        self._requests.clear()

    def _request(self, arguments: tuple[str, ...], now_s: float) -> None:
        asked_s = self._asked_s.get(arguments, -RETRY_S)
        if arguments in self._requests or now_s - asked_s < RETRY_S:
            return
        self._asked_s[arguments] = now_s
        with suppress(OSError):
            request = subprocess.Popen(
                [PROGRAM, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                process_group=0,
            )
            self._requests[arguments] = request, now_s

    def _reap(self, now_s: float) -> None:
        for arguments, (request, began_s) in tuple(self._requests.items()):
            if request.poll() is None and now_s - began_s < ANSWER_S:
                continue
            request.kill()
            request.wait()
            del self._requests[arguments]
        self._asked_s = {key: s for key, s in self._asked_s.items() if now_s - s < ANSWER_S}

    def _read(self) -> None:
        assert self._process.stdout is not None
        with suppress(ValueError, OSError):
            for line in self._process.stdout:
                if found := _LINE.match(line):
                    self._take(*found.groups())
        self.lost = True
        self._on_change()

    def _take(self, sign: str, number: str, what: str) -> None:
        if sign == "-":
            self._known.pop(number, None)
        elif _JOINS in what:
            output, _, put = what.partition(_JOINS)
            self._known[number] = output, put
        else:
            self._known[number] = what
        known = self._known.values()
        self.ports = frozenset(item for item in known if isinstance(item, str))
        self.links = frozenset(item for item in known if isinstance(item, tuple))
        self._on_change()

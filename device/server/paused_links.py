"""Links that PipeWire leaves paused after it has suspended and resumed one of their nodes.

PipeWire 0.3.65 resumes one of several links between two nodes and forgets the others, so their
channels are silent until the links are made again. `pw-link` does not show it; `pw-dump` does.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Collection
from typing import Any

PROGRAM = "pw-dump"
ANSWER_S = 0.5
"""Longest wait for the answer."""

SETTLES_S = 0.15
"""From an event of the server until its links have settled."""

PERIOD_S = 0.5
"""Shortest time between two queries."""


class PausedLinks:
    """Looks for paused links after events of the server. For one thread."""

    def __init__(self) -> None:
        self._events = -1
        self._due_s: float | None = None
        self._asked_s = -PERIOD_S

    def look(self, events: int, nodes: Collection[str], now_s: float) -> list[str]:
        """Return the numbers of forgotten links, if a query is due; it takes some 20 ms.

        events: of the server until now. nodes: names of nodes that play now; only their links
        count.
        """
        if events != self._events:
            self._events = events
            self._due_s = self._due_s or max(now_s + SETTLES_S, self._asked_s + PERIOD_S)
        if self._due_s is None or now_s < self._due_s:
            return []
        self._due_s, self._asked_s = None, now_s
        try:
            done = subprocess.run(
                [PROGRAM], stdin=subprocess.DEVNULL, capture_output=True, timeout=ANSWER_S
            )
            return paused_links(json.loads(done.stdout), nodes)
        except (OSError, subprocess.TimeoutExpired, ValueError):
            return []


def paused_links(objects: Any, nodes: Collection[str]) -> list[str]:
    """Return the numbers of links that are paused beside an active link of the same two nodes.

    objects: parsed output of `pw-dump`; anything else has no links. nodes: names; a link counts if
    one of its ends is among them.
    """
    names: dict[Any, str] = {}
    states: dict[tuple[Any, Any], dict[str, list[str]]] = {}
    for item in objects if isinstance(objects, list) else []:
        kind, info = str(item.get("type", "")), item.get("info") or {}
        if kind.endswith(":Node"):
            names[item.get("id")] = str((info.get("props") or {}).get("node.name", ""))
        elif kind.endswith(":Link"):
            ends = info.get("output-node-id"), info.get("input-node-id")
            by_state = states.setdefault(ends, {})
            by_state.setdefault(str(info.get("state")), []).append(str(item.get("id")))
    return [
        number
        for ends, by_state in states.items()
        if "active" in by_state and any(names.get(end) in nodes for end in ends)
        for number in by_state.get("paused", ())
    ]

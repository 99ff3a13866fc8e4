"""What `pw-cli --monitor` announces: objects that are new or gone, milliseconds before `pw-dump`.

`pw-dump` describes an object when it has asked for all that is known of it. The registry names the
two ends of a link at once, and that is enough to mirror it before its first cycle.
"""

from __future__ import annotations

import os
import re
from typing import Any

from device.server.graph import LINK_ENDS

READ_BYTES = 1 << 16
LONGEST_LINE_BYTES = 1 << 14  # of a longer line the rest is dropped; names may have any length

_ADDED = re.compile(r"remote \d+ added global: \tid (\d+), type ([\w:]+)/\d+")
_REMOVED = re.compile(r"remote \d+ removed global: \tid (\d+)")
_PROPERTY = re.compile(r'\s*\*?\s*([\w.-]+) = "(.*)"')
_KINDS = (":Core", ":Node", ":Port", ":Link")
_ENDS = {"link." + end.removesuffix("-id").replace("-", "."): end for end in LINK_ENDS}


class Announcements:
    """Reads a pipe that `pw-cli` prints to. One thread calls it. file: its number."""

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

"""Waiting requests of live pages. A newer value replaces a waiting value of the same setting."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

WAITING_MAX = 16  # largest number of waiting requests

Answer = Callable[[dict[str, Any]], object]


def _setting(asked: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return the setting that gets a value; None if the effect depends on earlier requests."""
    ((name, value),) = asked.items() if len(asked) == 1 else (("", None),)
    if name in ("set", "sync") and isinstance(value, dict):
        return name, *sorted(value)
    return (name,) if name == "mute" else None


class RequestQueue:
    """Requests in order of arrival, each with a function for its answer. Any thread may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[tuple[Mapping[str, Any], Answer]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, asked: Mapping[str, Any], answer: Answer) -> bool:
        """Add a request; return whether none waited before.

        The request that it replaces is answered at once, as is itself if the queue is full.
        """
        with self._lock:
            setting, earlier, was_empty = _setting(asked), list(self._waiting), not self._waiting
            while setting and earlier and _setting(earlier[-1][0]) not in (None, setting):
                earlier.pop()
            if setting and earlier and _setting(earlier[-1][0]):
                self._waiting.remove(earlier[-1])
                earlier[-1][1]({"done": True})
            if len(self._waiting) < WAITING_MAX:
                self._waiting.append((asked, answer))
                return was_empty
        answer({"error": "too many requests wait; try again"})
        return False

    def take(self) -> tuple[Mapping[str, Any], Answer] | None:
        """Remove and return the first request; None if there is none."""
        with self._lock:
            return self._waiting.pop(0) if self._waiting else None

    def drop(self, answer: Answer) -> None:
        """Remove the request with this function, if it still waits."""
        with self._lock:
            self._waiting = [one for one in self._waiting if one[1] is not answer]

"""Waiting requests of live pages. A newer value replaces a waiting value of the same setting."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

WAITING_MAX = 16  # largest number of waiting requests


@dataclass(eq=False)
class Waiting:
    """A waiting request. answer: called once, with the answer."""

    asked: Mapping[str, Any]
    answer: Callable[[dict[str, Any]], None]

    @property
    def setting(self) -> tuple[str, ...] | None:
        """The setting that it gives a value; None: its effect depends on earlier requests."""
        name, value = next(iter(self.asked.items()), ("", None))
        if len(self.asked) == 1 and name in ("set", "sync") and isinstance(value, dict):
            return name, *sorted(value)
        return (name,) if len(self.asked) == 1 and name == "mute" else None


class RequestQueue:
    """Requests in order of arrival. Any thread may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[Waiting] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, request: Waiting) -> bool:
        """Add a request; return whether none waited before.

        The request that it replaces is answered at once, as is itself if the queue is full.
        """
        with self._lock:
            was_empty = not self._waiting
            old = self._replaced_by(request)
            if old is not None:
                self._waiting.remove(old)
            is_full = len(self._waiting) >= WAITING_MAX
            if not is_full:
                self._waiting.append(request)
        if old is not None:
            old.answer({"done": True})
        if is_full:
            request.answer({"error": "too many requests wait; try again"})
        return was_empty

    def take(self) -> Waiting | None:
        """Remove and return the first request; None if there is none."""
        with self._lock:
            return self._waiting.pop(0) if self._waiting else None

    def drop(self, request: Waiting) -> None:
        """Remove a request, if it still waits."""
        with self._lock:
            self._waiting = [one for one in self._waiting if one is not request]

    def _replaced_by(self, request: Waiting) -> Waiting | None:
        setting = request.setting
        for one in reversed(self._waiting) if setting else ():
            if one.setting in (None, setting):  # None: its effect depends on earlier values
                return one if one.setting else None
        return None

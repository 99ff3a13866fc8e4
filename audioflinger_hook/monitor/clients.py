"""What each browser gets: of each kind of message only the newest, however slow the browser is.

A browser acknowledges frames, and few are under way at a time. So neither memory nor the delay of
what it shows depends on how fast it reads.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

CLIENTS_MAX = 8
UNDER_WAY_MAX = 4
"""Frames sent and not acknowledged: at 30 a second, enough for 130 ms there and back."""

ANSWERS_MAX = 8


class Client:
    """One browser. For the event loop's thread."""

    def __init__(self) -> None:
        self.overwritten = 0  # frames that it never got, as newer ones came first
        self._newest: dict[str, str] = {}
        self._frame: str | None = None
        self._answers: deque[str] = deque(maxlen=ANSWERS_MAX)
        self._sent = self._acknowledged = 0
        self._wake = asyncio.Event()

    def tell(self, kind: str, text: str) -> None:
        """Send a message, unless a newer one of its kind comes first."""
        if kind == "frame":
            self.overwritten += self._frame is not None
            self._frame = text
        else:
            self._newest[kind] = text
        self._wake.set()

    def answer(self, text: str) -> None:
        """Send the answer to a request."""
        self._answers.append(text)
        self._wake.set()

    def acknowledge(self, number: int) -> None:
        """Note that a frame has arrived."""
        self._acknowledged = min(max(self._acknowledged, number), self._sent)
        self._wake.set()

    async def send_all(self, send: Callable[[str], Awaitable[None]]) -> None:
        """Send what there is, until cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._answers:
                await send(self._answers.popleft())
            for kind in tuple(self._newest):
                await send(f'{{"{kind}": {self._newest.pop(kind)}}}')
            if self._frame is not None and self._sent - self._acknowledged < UNDER_WAY_MAX:
                self._sent += 1
                frame, self._frame = self._frame, None
                counts = f'"n": {self._sent}, "overwritten": {self.overwritten}'
                await send(f'{{{counts}, "frame": {frame}}}')


class Clients:
    """All browsers, and the latest message of each kind for those that come later."""

    def __init__(self) -> None:
        self.latest: dict[str, dict[str, Any]] = {}  # contents by kind
        self._all: set[Client] = set()
        self._overwritten_before = 0

    def __len__(self) -> int:
        return len(self._all)

    @property
    def overwritten(self) -> int:
        """Frames that browsers so far never got, as newer ones came first."""
        return self._overwritten_before + sum(client.overwritten for client in self._all)

    def tell(self, kind: str, content: dict[str, Any]) -> None:
        """Send a message of the daemon to all."""
        if kind == "link" and not content["connected"]:
            self.latest.clear()  # What a daemon said that is gone is not true any more.
        self.latest[kind] = content
        text = json.dumps(content)
        for client in self._all:
            client.tell(kind, text)

    def add(self) -> Client:
        """Return a new client, which gets the latest of everything."""
        client = Client()
        self._all.add(client)
        for kind, content in self.latest.items():
            client.tell(kind, json.dumps(content))
        return client

    def remove(self, client: Client) -> None:
        """Forget a client."""
        self._all.discard(client)
        self._overwritten_before += client.overwritten

"""Queues of messages to the browsers. A slow browser gets only the newest message of each kind.

A frame is a message with levels and frequencies. A browser acknowledges each frame. At most
UNDER_WAY_MAX frames may be unacknowledged, which limits the memory and the delay.
"""

import asyncio
import json
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

from audioflinger_hook.service.request_queue import RequestQueue

CLIENTS_MAX = 8
UNDER_WAY_MAX = 4  # frames; at 30 frames/s, enough for a round trip of 130 ms
ANSWERS_MAX = 8


class Client:
    """The queue of one browser. Only the event loop's thread may use it."""

    def __init__(self) -> None:
        self.requests = RequestQueue()  # waiting requests of the browser
        self.tries = False  # whether it plays an offset on trial
        self.overwritten = 0  # number of queued frames that a newer frame replaced
        self._newest: dict[str, str] = {}
        self._frame: str | None = None
        self._answers: deque[str] = deque(maxlen=ANSWERS_MAX)
        self._sent = self._acknowledged = 0
        self._wake = asyncio.Event()

    def tell(self, kind: str, text: str) -> None:
        """Queue a message, which replaces a queued message of the same kind."""
        if kind == "frame":
            self.overwritten += self._frame is not None
            self._frame = text
        else:
            self._newest[kind] = text
        self._wake.set()

    def answer(self, text: str) -> None:
        """Queue the answer to a request. Only the latest ANSWERS_MAX answers are kept."""
        self._answers.append(text)
        self._wake.set()

    def acknowledge(self, number: int) -> None:
        """Record that the browser has received all frames up to `number`."""
        self._acknowledged = min(max(self._acknowledged, number), self._sent)
        self._wake.set()

    async def send_all(self, send: Callable[[str], Awaitable[None]]) -> None:
        """Send queued messages until the task is cancelled."""
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
    """All browsers, and the latest message of each kind for browsers that connect later.

    Only the event loop's thread may use it.
    """

    def __init__(self) -> None:
        self.latest: dict[str, dict[str, Any]] = {}  # contents of the latest message of each kind
        self._all: set[Client] = set()
        self._overwritten_before = 0

    def __len__(self) -> int:
        return len(self._all)

    @property
    def overwritten(self) -> int:
        """Total number of queued frames, over all browsers, that newer frames have replaced."""
        return self._overwritten_before + sum(client.overwritten for client in self._all)

    def tell(self, kind: str, content: dict[str, Any]) -> None:
        """Queue a message for all browsers."""
        if kind == "link" and not content["connected"]:
            self.latest.clear()  # the messages are not valid for the next daemon
        self.latest[kind] = content
        text = json.dumps(content)
        for client in self._all:
            client.tell(kind, text)

    def add(self) -> Client:
        """Return a new client, with the latest message of each kind in its queue."""
        client = Client()
        self._all.add(client)
        for kind, content in self.latest.items():
            client.tell(kind, json.dumps(content))
        return client

    def remove(self, client: Client) -> None:
        """Remove a client."""
        self._all.discard(client)
        self._overwritten_before += client.overwritten

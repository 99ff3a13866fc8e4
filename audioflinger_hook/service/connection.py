"""One client of the status server: lines in, lines out, within bounds of size and time."""

from __future__ import annotations

import json
import selectors
import socket
from collections.abc import Callable

from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.status import Status

REQUEST_BYTES_MAX = 4096
"""Of one request, its line break included."""

REQUEST_TIME_S = 1.0
"""For a request to come whole and its answer to be taken."""

LIFETIME_S = 10.0
"""After which a client makes room for others, however well it behaves."""

ASK_STATUS = {"ask": "status"}


def answer(request: bytes, read: Callable[[], Status]) -> bytes:
    """Return the line for a request: the status, or `{"error": ...}` with what is wrong.

    Never raises: what `read` raises becomes such an answer, too.
    """
    try:
        asked = json.loads(request)
    except (ValueError, RecursionError):
        return _error('the request is not JSON; send {"ask": "status"} and a line break')
    if asked != ASK_STATUS:
        return _error('the request is not known; allowed: {"ask": "status"}')
    try:
        return read().to_json().encode() + b"\n"
    except Exception as error:  # the program's own fault, but its thread must live
        return _error(f"the status cannot be told: {type(error).__name__}: {error}")


def _error(message: str) -> bytes:
    return json.dumps({"error": one_line(message)}).encode() + b"\n"


class Connection:
    """A client that is connected; all calls come from the server's thread.

    end_s: when it will have taken too long; then whoever holds it closes it.
    """

    def __init__(self, accepted: socket.socket, now_s: float) -> None:
        accepted.setblocking(False)
        self.socket = accepted
        self.end_s = now_s + REQUEST_TIME_S
        self._last_s = now_s + LIFETIME_S
        self._requests = bytearray()
        self._answer = b""
        self._ended = False  # the client will send no more, or may not

    def interest(self) -> int:
        """Return the selector's event to wait for."""
        # A request that is here already waits for its turn, which comes when there is room.
        ready = self._answer or self._ended or b"\n" in self._requests
        return selectors.EVENT_WRITE if ready else selectors.EVENT_READ

    def serve(self, read: Callable[[], Status], now_s: float) -> bool:
        """Go on without waiting, one answer at most; return whether there will be more.

        Raises
        ------
        OSError
            The client has gone.
        """
        if not self._answer:
            self._receive()
            self._take_one(read)
        if self._answer and self._send():
            self.end_s = min(now_s + REQUEST_TIME_S, self._last_s)
        return bool(self._answer or b"\n" in self._requests or not self._ended)

    def close(self) -> None:
        """Close the connection."""
        self.socket.close()

    def _receive(self) -> None:
        room = REQUEST_BYTES_MAX - len(self._requests)
        if self._ended or b"\n" in self._requests or not room:
            return
        try:
            received = self.socket.recv(room)
        except BlockingIOError:
            return
        self._requests += received
        self._ended = not received

    def _take_one(self, read: Callable[[], Status]) -> None:
        request, end, rest = self._requests.partition(b"\n")
        if end:
            self._requests = bytearray(rest)
            self._answer = answer(bytes(request), read)
        elif len(request) >= REQUEST_BYTES_MAX:
            self._refuse(f"the request is longer than {REQUEST_BYTES_MAX} bytes")
        elif request and self._ended:
            self._refuse("the request has no line break")

    def _refuse(self, message: str) -> None:
        self._requests.clear()
        self._ended = True
        self._answer = _error(f'{message}; send {{"ask": "status"}} and a line break')

    def _send(self) -> bool:
        """Send what the client takes; return whether that was all."""
        try:
            sent = self.socket.send(self._answer, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return False
        self._answer = self._answer[sent:]
        return not self._answer

"""The status server: a socket in the daemon's folder that answers the same user only."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
import stat
import struct
import threading
from collections.abc import Callable, Generator

from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from device.errors import InternalError, UsageError

NAME = "status.sock"
ASK_STATUS = {"ask": "status"}

CLIENTS_MAX = 8
"""Clients served at a time; others wait in the socket's queue."""

REQUEST_BYTES_MAX = 4096
"""Of one request, its line break included."""

REQUEST_TIME_S = 1.0
"""For a whole request to arrive and its answer to be read."""

LIFETIME_S = 10.0
"""Longest connection; then the client makes room for others."""

PAUSE_S = 0.01
"""Pause after every round, which limits the CPU time that clients can cause."""

STOP_S = 2.0
"""Longest wait of `stop` for a status function that hangs."""

_ADVICE = 'send {"ask": "status"} and a line break'
_PEER = struct.Struct("3i")


def answer(request: bytes, read: Callable[[], Status]) -> bytes:
    """Return the line that answers a request: the status, or `{"error": ...}`; never raises."""
    try:
        asked = json.loads(request)
    except (ValueError, RecursionError):
        return _error(f"the request is not JSON; {_ADVICE}")
    if asked != ASK_STATUS:
        return _error('the request is not known; allowed: {"ask": "status"}')
    try:
        return read().to_json().encode() + b"\n"
    except Exception as error:  # an error of the program must not end its thread
        return _error(f"the status is not available: {type(error).__name__}: {error}")


def peer_uid(connected: socket.socket) -> int:
    """Return the user of the process at the other end."""
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return int(_PEER.unpack(raw)[1])


class StatusServer:
    """Answers lines of `{"ask": "status"}` on a thread of its own, from `start` to `stop`.

    No client can raise an error, or keep others waiting. One thread makes, starts and stops it.
    Hold the `DaemonLock` before: the lock, not the socket, ensures that there is one daemon.
    `read` is called on the server's thread; if it raises, the client is told. `faults` counts
    errors of the program itself.

    Raises
    ------
    UsageError
        A living daemon answers there, or the socket's name is taken by something else.
    InternalError
        The system provides no socket.
    """

    def __init__(
        self, folder: RuntimeFolder, read: Callable[[], Status], clock: Callable[[], float]
    ) -> None:
        self.faults = 0
        self._folder = folder
        self._read = read
        self._clock = clock
        self._clients: set[_Client] = set()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._listener, self._inode = _listen(folder)
        self._wake_fd = os.eventfd(0, os.EFD_CLOEXEC)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._wake_fd, selectors.EVENT_READ)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._accepts = True

    def start(self) -> None:
        """Begin to answer."""
        self._thread = threading.Thread(target=self._run, name="cushion-status", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close all connections and remove the socket. May be repeated."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        os.eventfd_write(self._wake_fd, 1)
        if self._thread is not None:
            self._thread.join(STOP_S)
        for client in self._clients:
            client.socket.close()
        self._clients.clear()
        self._selector.close()
        with contextlib.suppress(OSError):
            entry = self._folder.entry(NAME)
            if entry is not None and (entry.st_dev, entry.st_ino) == self._inode:
                os.unlink(NAME, dir_fd=self._folder.fd)
        self._listener.close()
        os.close(self._wake_fd)

    def __enter__(self) -> StatusServer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._round()
            except Exception:  # the daemon goes on whatever happens here
                self.faults += 1
            self._stopping.wait(PAUSE_S)

    def _round(self) -> None:
        patience_s = None
        if self._clients:
            first_s = min(client.end_s for client in self._clients)
            patience_s = max(0.0, first_s - self._clock())
        for key, _ in self._selector.select(patience_s):
            if key.fileobj is self._listener:
                self._accept()
            elif isinstance(key.data, _Client):
                self._advance(key.data)
        now_s = self._clock()
        for client in [client for client in self._clients if client.end_s <= now_s]:
            self._drop(client)
        has_room = len(self._clients) < CLIENTS_MAX
        if has_room and not self._accepts:
            self._selector.register(self._listener, selectors.EVENT_READ)
        elif self._accepts and not has_room:
            self._selector.unregister(self._listener)
        self._accepts = has_room

    def _accept(self) -> None:
        while len(self._clients) < CLIENTS_MAX:
            try:
                accepted, _ = self._listener.accept()
            except OSError:  # no client left, gone again, or no descriptor left
                return
            if peer_uid(accepted) != os.geteuid():
                accepted.close()
                continue
            client = _Client(accepted, self._read, self._clock())
            self._clients.add(client)
            self._selector.register(accepted, selectors.EVENT_READ, client)
            self._advance(client)  # most requests have arrived already

    def _advance(self, client: _Client) -> None:
        events = 0
        try:
            client.now_s = self._clock()
            events = next(client.steps, 0)
        except OSError:  # the client has gone
            pass
        finally:
            if events:
                self._selector.modify(client.socket, events, client)
            else:
                self._drop(client)

    def _drop(self, client: _Client) -> None:
        self._clients.discard(client)
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.steps.close()
        client.socket.close()


class _Client:
    """One connection: `steps` does at most one answer at a time and yields what to wait for.

    now_s: time of the present step; end_s: when the server closes the connection.
    """

    def __init__(self, accepted: socket.socket, read: Callable[[], Status], now_s: float) -> None:
        accepted.setblocking(False)
        self.socket = accepted
        self._read = read
        self.now_s = now_s
        self.end_s = now_s + REQUEST_TIME_S
        self._last_s = now_s + LIFETIME_S
        self._answer = b""
        self.steps = self._converse()

    def _converse(self) -> Generator[int, None, None]:
        requests = b""
        while True:
            request, line_break, rest = requests.partition(b"\n")
            if line_break:
                requests = rest
                yield from self._send(answer(request, self._read))
                self.end_s = min(self.now_s + REQUEST_TIME_S, self._last_s)
                # A further request waits for the next round.
                yield selectors.EVENT_WRITE if b"\n" in requests else selectors.EVENT_READ
                continue
            if len(requests) >= REQUEST_BYTES_MAX:
                problem = f"the request is longer than {REQUEST_BYTES_MAX} bytes"
                yield from self._send(_error(f"{problem}; {_ADVICE}"))
                return
            try:
                received = self.socket.recv(REQUEST_BYTES_MAX - len(requests))
            except BlockingIOError:
                yield selectors.EVENT_READ
                continue
            if not received:
                if requests:
                    yield from self._send(_error(f"the request has no line break; {_ADVICE}"))
                return
            requests += received

    def _send(self, line: bytes) -> Generator[int, None, None]:
        self._answer = line
        while self._answer:
            try:
                sent = self.socket.send(self._answer, socket.MSG_NOSIGNAL)
            except BlockingIOError:
                sent = 0
            self._answer = self._answer[sent:]
            if self._answer:
                yield selectors.EVENT_WRITE


def _error(message: str) -> bytes:
    return json.dumps({"error": one_line(message)}).encode() + b"\n"


def _listen(folder: RuntimeFolder) -> tuple[socket.socket, tuple[int, int]]:
    """Return a listening socket and its device and inode; a dead daemon's socket is replaced."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)
        os.fchmod(listener.fileno(), 0o600)  # the file has this mode from its first moment
        _remove_dead(folder)
        listener.bind(folder.address(NAME))
        listener.listen(CLIENTS_MAX)
        entry = os.stat(NAME, dir_fd=folder.fd, follow_symlinks=False)
    except OSError as error:
        listener.close()
        raise InternalError(f"cannot listen on {folder.path / NAME}: {error.strerror}") from error
    except BaseException:
        listener.close()
        raise
    return listener, (entry.st_dev, entry.st_ino)


def _remove_dead(folder: RuntimeFolder) -> None:
    entry = folder.entry(NAME)
    if entry is None:
        return
    path = folder.path / NAME
    if entry.st_uid != os.geteuid():
        raise UsageError(f"{path} belongs to user {entry.st_uid}; remove it as that user")
    if not stat.S_ISSOCK(entry.st_mode):
        raise UsageError(f"{path} is no socket; remove it")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(folder.address(NAME))
        except ConnectionRefusedError:
            os.unlink(NAME, dir_fd=folder.fd)
            return
        except BlockingIOError:  # a living daemon whose queue is full
            pass
    raise UsageError(
        f"another cushion daemon answers at {path}; allowed: one per user; "
        "ask it with `cushion status`, or stop it first"
    )

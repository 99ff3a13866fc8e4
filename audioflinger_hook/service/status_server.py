"""The status server: a socket in the daemon's folder that answers only the daemon's user."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import struct
import threading
from collections.abc import Callable

from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from device.errors import InternalError, UsageError

NAME = "status.sock"
ASK_STATUS = {"ask": "status"}

CLIENTS_MAX = 8
"""Clients served at a time; others wait in the socket's queue."""

REQUEST_BYTES_MAX = 4096
"""Largest size of one request, including its line break."""

REQUEST_TIME_S = 1.0
"""Time for a whole request to arrive, and for its answer to be read."""

LIFETIME_S = 10.0
"""Longest connection; then it is closed to make room for other clients."""

PAUSE_S = 0.01
"""Pause after each answer to a client, which limits the CPU time that clients can cause."""

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
        return to_json(read()).encode() + b"\n"
    except Exception as error:  # an error of the program must not end its thread
        return _error(f"the status is not available: {type(error).__name__}: {error}")


def peer_uid(connected: socket.socket) -> int:
    """Return the user of the process at the other end."""
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return int(_PEER.unpack(raw)[1])


class StatusServer:
    """Answers lines of `{"ask": "status"}` within a `with`; each of its threads serves one client.

    No client can raise an error or keep others waiting. One thread makes, enters and leaves the
    server. Hold the `DaemonLock` first: the lock, not the socket, ensures that only one daemon
    runs. `read` is called on the server's threads; if it raises, the client is told.

    UsageError: a running daemon answers there, or another kind of file has the socket's name.
    InternalError: the system provides no socket.
    """

    def __init__(
        self, folder: RuntimeFolder, read: Callable[[], Status], clock: Callable[[], float]
    ) -> None:
        self._folder = folder
        self._read = read
        self._clock = clock
        self._clients: set[socket.socket] = set()
        self._stopping = threading.Event()
        self._listener, self._inode = _listen(folder)
        self._threads = [
            threading.Thread(target=self._serve, name="cushion-status", daemon=True)
            for _ in range(CLIENTS_MAX)
        ]

    def stop(self) -> None:
        """Close all connections and remove the socket. May be repeated."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        end_s = self._clock() + STOP_S
        for connected in (self._listener, *self._clients):
            with contextlib.suppress(OSError):  # the client is gone
                connected.shutdown(socket.SHUT_RDWR)  # wakes the threads that wait for it
        for thread in self._threads:
            thread.join(max(0.0, end_s - self._clock()))
        with contextlib.suppress(OSError):
            entry = self._folder.entry(NAME)
            if entry is not None and (entry.st_dev, entry.st_ino) == self._inode:
                os.unlink(NAME, dir_fd=self._folder.fd)
        self._listener.close()

    def __enter__(self) -> StatusServer:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _serve(self) -> None:
        while not self._stopping.wait(PAUSE_S):
            with contextlib.suppress(OSError):  # stopped, no descriptor left, client gone or late
                client, _ = self._listener.accept()
                with client:
                    self._clients.add(client)
                    try:
                        self._converse(client)
                    finally:
                        self._clients.discard(client)

    def _converse(self, client: socket.socket) -> None:
        """Answer this client until it disconnects; raises TimeoutError if it takes too long."""
        if peer_uid(client) != os.geteuid():
            return
        last_s = self._clock() + LIFETIME_S
        requests = b""
        while not self._stopping.is_set():
            end_s = min(self._clock() + REQUEST_TIME_S, last_s)
            while b"\n" not in requests and len(requests) < REQUEST_BYTES_MAX:
                self._set_timeout(client, end_s)
                received = client.recv(REQUEST_BYTES_MAX - len(requests))
                requests += received
                if not received:
                    if requests:
                        client.sendall(_error(f"the request has no line break; {_ADVICE}"))
                    return
            request, line_break, requests = requests.partition(b"\n")
            if not line_break:
                problem = f"the request is longer than {REQUEST_BYTES_MAX} bytes"
                client.sendall(_error(f"{problem}; {_ADVICE}"))
                return
            self._set_timeout(client, end_s)
            client.sendall(answer(request, self._read))
            self._stopping.wait(PAUSE_S)

    def _set_timeout(self, client: socket.socket, end_s: float) -> None:
        left_s = end_s - self._clock()
        if left_s <= 0.0:
            raise TimeoutError
        client.settimeout(left_s)


def _error(message: str) -> bytes:
    return json.dumps({"error": one_line(message)}).encode() + b"\n"


def _listen(folder: RuntimeFolder) -> tuple[socket.socket, tuple[int, int]]:
    """Return a listening socket and its device and inode; a dead daemon's socket is replaced."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        os.fchmod(listener.fileno(), 0o600)  # so the file has this mode from the start
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
        raise UsageError(f"{path} is not a socket; remove it")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(folder.address(NAME))
        except ConnectionRefusedError:
            os.unlink(NAME, dir_fd=folder.fd)
            return
        except BlockingIOError:  # a running daemon whose queue is full
            pass
    raise UsageError(
        f"another cushion daemon answers at {path}; allowed: one per user; "
        "ask it with `cushion status`, or stop it first"
    )

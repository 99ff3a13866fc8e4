"""The daemon's server: a socket in its folder that answers only the daemon's user.

A request is one line of JSON. `{"ask": "status"}` is answered by the status. With the number of the
protocol, `{"ask": "watch", "protocol": 1, "rate_hz": 30}` is answered by lines without end, and
`{"ask": "control", "protocol": 1, ...}` by one line.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import stat
import struct
import threading
from collections.abc import Callable
from typing import Any, Protocol

from audioflinger_hook import __version__
from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from device.errors import InternalError, UsageError

NAME = "status.sock"
ASK_STATUS = {"ask": "status"}

PROTOCOL = 1  # number of the form of `watch` and `control`; another number is refused
WATCHERS_MAX = 4  # clients that may watch at a time; the other threads are left for the rest
RATE_MAX_HZ = 60.0
SELDOM_S = 0.25  # time between frames that contain only the state

STATUS_EVERY_S = 2.0
"""A watching client gets frames at its rate, and the whole status as often as this."""

WATCH_BUFFER_BYTES = 8192
"""Size of a watching client's buffer in the kernel. What does not fit is never sent: the next
frame replaces it."""

CLIENTS_MAX = 8  # clients served at a time; others wait in the socket's queue
REQUEST_BYTES_MAX = 4096  # largest size of one request, including its line break
REQUEST_TIME_S = 1.0  # time for a whole request to arrive, and for its answer to be read
LIFETIME_S = 10.0  # longest connection; then it is closed to make room for other clients

PAUSE_S = 0.01
"""Pause after each answer to a client, which limits the CPU time that clients can cause."""

STOP_S = 2.0  # longest wait of `stop` for a status function that hangs
_ADVICE = 'send {"ask": "status"} and a line break'
_KNOWN = 'allowed: {"ask": "status"}, or watch or control with "protocol": 1'
_PEER = struct.Struct("3i")
_ASK = json.dumps(ASK_STATUS).encode()


def answer(request: bytes, read: Callable[[], Status]) -> bytes:
    """Return the line that answers a request: the status, or `{"error": ...}`; never raises."""
    try:
        asked = json.loads(request)
    except (ValueError, RecursionError):
        return _error(f"the request is not JSON; {_ADVICE}")
    if asked != ASK_STATUS:
        return _error(f"the request is not known; {_KNOWN}")
    try:
        return to_json(read()).encode() + b"\n"
    except Exception as error:  # an error of the program must not end its thread
        return _error(f"the status is not available: {type(error).__name__}: {error}")


class Live(Protocol):
    """What a page shows and changes; the server's threads call it."""

    settings: dict[str, Any]  # another object after each change

    def frame(self, missed: int, *, in_memory: bool) -> tuple[bytes, bool]:
        """Return a frame as a line of JSON, and whether the next one may come after SELDOM_S.

        missed: frames that were not sent. in_memory: whether the client reads the figures itself.
        """
        ...

    def watched_by(self, page: str) -> None:
        """Note the address of a page that watches."""
        ...

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request and return its answer; never raises."""
        ...


def peer_uid(connected: socket.socket) -> int:
    """Return the user of the process at the other end."""
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return int(_PEER.unpack(raw)[1])


class StatusServer:
    """Answers requests within a `with`; each of its threads serves one client.

    No client can raise an error or keep others waiting. One thread makes, enters and leaves the
    server. Hold the `DaemonLock` first: the lock, not the socket, ensures that only one daemon
    runs. `read` is called on the server's threads; if it raises, the client gets an error. live:
    what clients may watch and control; None: nothing.

    UsageError: a running daemon answers there, or another kind of file has the socket's name.
    InternalError: the system provides no socket.
    """

    def __init__(
        self,
        folder: RuntimeFolder,
        read: Callable[[], Status],
        clock: Callable[[], float],
        live: Live | None = None,
    ) -> None:
        self._folder, self._read, self._clock, self._live = folder, read, clock, live
        self._watchers = threading.Semaphore(WATCHERS_MAX)
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
                requests += (received := client.recv(REQUEST_BYTES_MAX - len(requests)))
                if not received:
                    if requests:
                        client.sendall(_error(f"the request has no line break; {_ADVICE}"))
                    return
            request, line_break, requests = requests.partition(b"\n")
            if not line_break:
                problem = f"the request is longer than {REQUEST_BYTES_MAX} bytes"
                client.sendall(_error(f"{problem}; {_ADVICE}"))
                return
            asked = self._asked_of_live(request)
            if asked and asked["ask"] == "watch":
                self._let_watch(client, asked)
                return
            replied = self._reply(asked) if asked else answer(request, self._read)
            self._set_timeout(client, end_s + REQUEST_TIME_S)
            client.sendall(replied)
            self._stopping.wait(PAUSE_S)

    def _asked_of_live(self, request: bytes) -> dict[str, Any] | None:
        """Return a request to watch or control, None for any other."""
        with contextlib.suppress(ValueError, RecursionError):
            asked = json.loads(request)
            known = isinstance(asked, dict) and asked.get("ask") in ("watch", "control")
            return asked if known and self._live is not None else None
        return None

    def _reply(self, asked: dict[str, Any]) -> bytes:
        assert self._live is not None
        return _other_protocol(asked) or _line(self._live.control(asked))

    def _let_watch(self, client: socket.socket, asked: dict[str, Any]) -> None:
        """Send lines until the client is gone; what it does not read in time is left out."""
        rate_hz = asked.get("rate_hz", 30.0)
        if refusal := _other_protocol(asked):
            client.sendall(refusal)
        elif type(rate_hz) not in (int, float) or not 1.0 <= rate_hz <= RATE_MAX_HZ:
            client.sendall(_error(f"rate_hz is out of range; allowed: 1 to {RATE_MAX_HZ:g}"))
        elif not self._watchers.acquire(blocking=False):
            client.sendall(_error(f"{WATCHERS_MAX} clients watch already; close one of them"))
        else:
            if self._live is not None and isinstance(page := asked.get("page"), str):
                self._live.watched_by(page)
            try:
                self._watch(client, 1.0 / rate_hz, in_memory=asked.get("memory") is True)
            finally:
                self._watchers.release()

    def _watch(self, client: socket.socket, period_s: float, *, in_memory: bool) -> None:
        live = self._live
        assert live is not None
        client.setblocking(False)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WATCH_BUFFER_BYTES)
        rest = _line({"hello": {"protocol": PROTOCOL, "version": __version__}})
        # Its time limit is the pause; `stop` and the client's end cut it short.
        ends = select.poll()
        ends.register(client, select.POLLHUP)
        now_s = due_s = self._clock()
        status_due_s, told, missed, seldom = now_s, None, 0, False
        while True:
            if not rest:
                try:
                    rest, seldom = live.frame(missed, in_memory=in_memory)
                except Exception as error:  # an engine that ends meanwhile must not end this thread
                    client.send(_error(f"no frame: {type(error).__name__}: {error}"))
                    return
                if live.settings is not told:
                    told, status_due_s = live.settings, now_s
                    rest += _line({"settings": told})
                if now_s >= status_due_s:
                    status_due_s = now_s + STATUS_EVERY_S
                    rest += b'{"status": %b}\n' % answer(_ASK, self._read).rstrip()
            try:
                rest = rest[client.send(rest) :]
            except BlockingIOError:
                missed += 1
            now_s = self._clock()
            due_s = max(due_s + (max(period_s, SELDOM_S) if seldom else period_s), now_s)
            if ends.poll(1e3 * (due_s - now_s)) or self._stopping.is_set():
                return

    def _set_timeout(self, client: socket.socket, end_s: float) -> None:
        left_s = end_s - self._clock()
        if left_s <= 0.0:
            raise TimeoutError
        client.settimeout(left_s)


def _other_protocol(asked: dict[str, Any]) -> bytes | None:
    if asked.get("protocol") == PROTOCOL:
        return None
    return _error(
        f"this daemon (version {__version__}) speaks protocol {PROTOCOL}; "
        "restart the page or the daemon, so that both have the same version"
    )


def _error(message: str) -> bytes:
    return _line({"error": one_line(message)})


def _line(document: dict[str, Any]) -> bytes:
    return json.dumps(document).encode() + b"\n"


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

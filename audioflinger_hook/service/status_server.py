"""Server for a daemon's status and control, on a Unix socket that only the daemon's user may use.

A request is one line of JSON:

- `{"ask": "status"}` is answered by one line with the status.
- `{"ask": "watch", "protocol": 1, "rate_hz": 30}` is answered by an unlimited sequence of lines.
- `{"ask": "control", "protocol": 1, ...}` is answered by one line; see `daemon/live_control.py`.
"""

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

PROTOCOL = 1  # version of `watch` and `control`; requests with another version are refused
WATCHERS_MAX = 4  # largest number of watching clients, less than CLIENTS_MAX
RATE_MAX_HZ = 60.0
SELDOM_S = 0.25  # shortest interval of frames without levels and frequencies

STATUS_EVERY_S = 2.0  # interval of complete statuses for a watching client
WATCH_BUFFER_BYTES = 8192  # send buffer of a watching client; while it is full, frames are skipped

CLIENTS_MAX = 8  # clients that are served at a time; others wait in the socket's queue
REQUEST_BYTES_MAX = 4096  # largest request, including its line break
REQUEST_TIME_S = 1.0  # timeout for the arrival of a request, and for the delivery of an answer
LIFETIME_S = 10.0  # longest connection of a client that does not watch

PAUSE_S = 0.01  # pause after each answer, which limits the CPU load by clients
STOP_S = 2.0  # timeout of `stop`, in case a thread hangs in `read`
_ADVICE = 'send {"ask": "status"} and a line break'
_KNOWN = 'allowed: {"ask": "status"}, or watch or control with "protocol": 1'
_PEER = struct.Struct("3i")


class Live(Protocol):
    """Frames and settings for watching clients. The server's threads call the methods.

    A frame is a message with levels and frequencies.
    """

    settings: dict[str, Any]  # a new object after each change

    def frame(self, missed: int, *, in_memory: bool) -> tuple[bytes, bool]:
        """Return a frame as a line of JSON, and whether the next frame is due only after SELDOM_S.

        missed: number of frames that a slow client missed. in_memory: whether the client can read
        levels and frequencies from a memory-mapped file.
        """
        ...

    def watched_by(self, page: str) -> None:
        """Store the address of a live page that has connected."""
        ...

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request and return the answer. Raises nothing."""
        ...


def peer_uid(connected: socket.socket) -> int:
    """Return the user ID of the process at the other end of a socket."""
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return int(_PEER.unpack(raw)[1])


class StatusServer:
    """Context manager whose threads answer requests; each thread serves one client at a time.

    The caller must hold the `DaemonLock`.

    read: returns the status. The server's threads call it; an exception becomes an error answer.
    live: answers `watch` and `control`; None refuses these requests.
    clock: returns seconds. UsageError: another daemon listens, or the socket's name is in use by
    another user or file. InternalError: the socket cannot be created.
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
        """Close all connections and remove the socket. A second call has no effect."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        end_s = self._clock() + STOP_S
        for connected in (self._listener, *self._clients):
            with contextlib.suppress(OSError):  # already disconnected
                connected.shutdown(socket.SHUT_RDWR)  # wakes threads that wait for this socket
        for thread in self._threads:
            thread.join(max(0.0, end_s - self._clock()))
        with contextlib.suppress(OSError):
            entry = self._folder.entry(NAME)
            if entry is not None and (entry.st_dev, entry.st_ino) == self._inode:
                os.unlink(NAME, dir_fd=self._folder.fd)
        self._listener.close()

    def __enter__(self) -> "StatusServer":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _serve(self) -> None:
        while not self._stopping.wait(PAUSE_S):
            with contextlib.suppress(OSError):  # server stopped, client lost, or too many files
                client, _ = self._listener.accept()
                with client:
                    self._clients.add(client)
                    try:
                        self._converse(client)
                    finally:
                        self._clients.discard(client)

    def _converse(self, client: socket.socket) -> None:
        """Answer a client until the connection ends. TimeoutError: the client is too slow."""
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
            try:
                asked = json.loads(request)
            except (ValueError, RecursionError):
                answer = _error(f"the request is not JSON; {_ADVICE}")
            else:
                live = self._live if isinstance(asked, dict) else None
                if live and asked.get("ask") == "watch":
                    self._let_watch(client, live, asked)
                    return
                if live and asked.get("ask") == "control":
                    answer = _other_protocol(asked) or _line(live.control(asked))
                elif asked == ASK_STATUS:
                    answer = self._status()
                else:
                    answer = _error(f"the request is not known; {_KNOWN}")
            self._set_timeout(client, end_s + REQUEST_TIME_S)
            client.sendall(answer)
            self._stopping.wait(PAUSE_S)

    def _status(self) -> bytes:
        """Return the status, or `{"error": ...}`, as a line of JSON. Raises nothing."""
        try:
            return to_json(self._read()).encode() + b"\n"
        except Exception as error:  # an exception must not end the server's thread
            return _error(f"the status is not available: {type(error).__name__}: {error}")

    def _let_watch(self, client: socket.socket, live: Live, asked: dict[str, Any]) -> None:
        """Send lines until the client disconnects. A slow client gets fewer frames."""
        rate_hz = asked.get("rate_hz", 30.0)
        if refusal := _other_protocol(asked):
            client.sendall(refusal)
        elif type(rate_hz) not in (int, float) or not 1.0 <= rate_hz <= RATE_MAX_HZ:
            client.sendall(_error(f"rate_hz is out of range; allowed: 1 to {RATE_MAX_HZ:g}"))
        elif not self._watchers.acquire(blocking=False):
            client.sendall(_error(f"{WATCHERS_MAX} clients watch already; close one of them"))
        else:
            if isinstance(page := asked.get("page"), str):
                live.watched_by(page)
            try:
                self._watch(client, live, 1.0 / rate_hz, in_memory=asked.get("memory") is True)
            finally:
                self._watchers.release()

    def _watch(
        self, client: socket.socket, live: Live, period_s: float, *, in_memory: bool
    ) -> None:
        client.setblocking(False)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WATCH_BUFFER_BYTES)
        rest = _line({"hello": {"protocol": PROTOCOL, "version": __version__}})
        # poll() waits until the next frame is due. `stop` or a disconnection ends the wait.
        ends = select.poll()
        ends.register(client, select.POLLHUP)
        now_s = due_s = self._clock()
        status_due_s, told, missed, seldom = now_s, None, 0, False
        while True:
            if not rest:
                try:
                    rest, seldom = live.frame(missed, in_memory=in_memory)
                except Exception as error:  # an engine that ends must not end this thread
                    client.send(_error(f"no frame: {type(error).__name__}: {error}"))
                    return
                if live.settings is not told:
                    told, status_due_s = live.settings, now_s
                    rest += _line({"settings": told})
                if now_s >= status_due_s:
                    status_due_s = now_s + STATUS_EVERY_S
                    rest += b'{"status": %b}\n' % self._status().rstrip()
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
    """Replace an ended daemon's socket; return the new one, and its device and inode numbers."""
    try:
        with contextlib.ExitStack() as stack:
            listener = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            os.fchmod(listener.fileno(), 0o600)  # `bind` creates the file with this mode
            _remove_dead(folder)
            listener.bind(folder.address(NAME))
            listener.listen(CLIENTS_MAX)
            entry = os.stat(NAME, dir_fd=folder.fd, follow_symlinks=False)
            stack.pop_all()
    except OSError as error:
        raise InternalError(f"cannot listen on {folder.path / NAME}: {error.strerror}") from error
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
        except BlockingIOError:  # a daemon runs, and its queue is full
            pass
    raise UsageError(
        f"another cushion daemon answers at {path}; allowed: one per user; "
        "ask it with `cushion status`, or stop it first"
    )

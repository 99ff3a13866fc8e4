"""The status server: a socket in the daemon's folder that answers its user, and nobody else."""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import stat
import struct
import threading
from collections.abc import Callable
from types import TracebackType

from audioflinger_hook.service.connection import Connection
from audioflinger_hook.service.folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from device.errors import InternalError, UsageError

NAME = "status.sock"
CLIENTS_MAX = 8
"""Answered at a time; whoever comes then waits in the queue, a second or so."""

PAUSE_S = 0.01
"""Rest after every round: what one thread may do a second is bounded, whatever clients do."""

STOP_S = 2.0
"""How long `stop` waits for a `read` that hangs; then the thread is left to itself."""

_PEER = struct.Struct("3i")


class StatusServer:
    """Answers `{"ask": "status"}` lines from a thread of its own, until `stop`.

    read: gives the status; called on the server's thread, never twice at once. If it raises, the
    client is told so. clock: seconds, never backwards. Nothing a client does raises anywhere,
    and none keeps the others waiting. Made, started and stopped by one thread. Hold the
    `DaemonLock` first: it, not the socket, is what makes a daemon the only one.

    faults: rounds in which something went wrong that is the program's fault.

    Raises
    ------
    UsageError
        A living daemon answers there, or what stands there is no socket of ours.
    InternalError
        The system gives no socket.
    """

    def __init__(
        self, folder: RuntimeFolder, read: Callable[[], Status], clock: Callable[[], float]
    ) -> None:
        self.faults = 0
        self._folder = folder
        self._read = read
        self._clock = clock
        self._clients: set[Connection] = set()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._listener, self._inode = _listen(folder)
        self._waker, self._wake = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._accepting = True

    def start(self) -> None:
        """Begin to answer."""
        self._thread = threading.Thread(target=self._run, name="cushion-status", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End within a round, close all connections and remove the socket. May be repeated."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        with contextlib.suppress(OSError):
            self._waker.send(b"x")
        if self._thread is not None:
            self._thread.join(STOP_S)
        for client in self._clients:
            client.close()
        self._clients.clear()
        self._selector.close()
        # Remove before closing: afterwards it would look like a dead daemon's.
        with contextlib.suppress(OSError, UsageError), self._folder.alone():
            entry = self._folder.entry(NAME)
            if entry is not None and (entry.st_dev, entry.st_ino) == self._inode:
                os.unlink(NAME, dir_fd=self._folder.fd)
        for end in (self._listener, self._waker, self._wake):
            end.close()

    def __enter__(self) -> StatusServer:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    # ------------------------------------------------------------- the server's thread

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._round()
            except Exception:  # the daemon goes on whatever happens here
                self.faults += 1
            self._stopping.wait(PAUSE_S)

    def _round(self) -> None:
        for key, _ in self._selector.select(self._patience_s()):
            if key.fileobj is self._listener:
                self._accept()
            elif isinstance(key.data, Connection):
                self._serve(key.data)
        now_s = self._clock()
        for client in [client for client in self._clients if client.end_s <= now_s]:
            self._drop(client)
        self._listen_if(len(self._clients) < CLIENTS_MAX)

    def _patience_s(self) -> float | None:
        if not self._clients:
            return None
        first_s = min(client.end_s for client in self._clients)
        return max(0.0, first_s - self._clock())

    def _accept(self) -> None:
        while len(self._clients) < CLIENTS_MAX:
            try:
                accepted, _ = self._listener.accept()
            except OSError:  # nobody left, gone again, or no file left for it
                return
            if peer_uid(accepted) != os.geteuid():
                accepted.close()
                continue
            client = Connection(accepted, self._clock())
            self._clients.add(client)
            self._selector.register(client.socket, client.interest(), client)
            self._serve(client)  # most have asked already

    def _serve(self, client: Connection) -> None:
        going_on = False
        try:
            going_on = client.serve(self._read, self._clock())
        except OSError:  # reset, or gone
            pass
        finally:
            if going_on:
                self._selector.modify(client.socket, client.interest(), client)
            else:
                self._drop(client)

    def _drop(self, client: Connection) -> None:
        self._clients.discard(client)
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.close()

    def _listen_if(self, wanted: bool) -> None:
        if wanted and not self._accepting:
            self._selector.register(self._listener, selectors.EVENT_READ)
        elif self._accepting and not wanted:
            self._selector.unregister(self._listener)
        self._accepting = wanted


def peer_uid(connected: socket.socket) -> int:
    """Return whose process the other end was when it connected, or began to listen."""
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return int(_PEER.unpack(raw)[1])


def _listen(folder: RuntimeFolder) -> tuple[socket.socket, tuple[int, int]]:
    """Return a socket that listens, and which file it is; a dead daemon's is replaced."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)
        os.fchmod(listener.fileno(), 0o600)  # the file gets this mode, from its first moment on
        with folder.alone():
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
        except BlockingIOError:  # its queue is full: it lives
            pass
    raise UsageError(
        f"another cushion daemon answers at {path}; allowed: one a user; "
        "ask it with `cushion status`, or stop it first"
    )

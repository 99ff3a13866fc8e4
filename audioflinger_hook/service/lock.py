"""One daemon a user: a lock that the kernel lets go of when its holder dies, however it dies."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
from dataclasses import dataclass
from types import TracebackType

from audioflinger_hook.service.folder import RuntimeFolder
from audioflinger_hook.service.json_codec import from_json, to_json
from audioflinger_hook.service.one_line import one_line
from device.errors import UsageError, WriteError

NAME = "daemon.lock"
HOLDER_BYTES_MAX = 4096
# The sticky bit keeps who tidies runtime folders away from the file.
_MODE = stat.S_ISVTX | 0o600
_ATTEMPTS = 100


@dataclass(frozen=True)
class Holder:
    """Who holds the lock: process, when it started (text for people), the device's address."""

    pid: int
    started: str
    device: str


class DaemonLock:
    """The lock, held until `release` or the end of the process, kill -9 included.

    Programs started meanwhile do not inherit it; a copy of the process (fork without exec) does,
    and holds it on. Made and released by one thread.

    Raises
    ------
    UsageError
        Another daemon holds it; the message says who. Or what stands there is no file of ours.
    WriteError
        The holder could not be written: the disk is full.
    """

    def __init__(self, folder: RuntimeFolder, holder: Holder) -> None:
        self._path = folder.path / NAME
        self._fd = _open_locked(folder)
        try:
            self.tell(holder)
        except WriteError:
            self.release()
            raise

    def tell(self, holder: Holder) -> None:
        """Let others read that this one holds it; WriteError as above."""
        try:
            os.ftruncate(self._fd, 0)
            os.pwrite(self._fd, to_json(holder).encode() + b"\n", 0)
        except OSError as error:
            raise WriteError(
                f"cannot write {self._path}: {error.strerror}; free some space"
            ) from error

    def release(self) -> None:
        """Let go. The file stays, empty. May be called more than once."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, 0)
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> DaemonLock:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


def _open_locked(folder: RuntimeFolder) -> int:
    for _ in range(_ATTEMPTS):
        fd = _open(folder)
        try:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise _held(fd) from error
            # Someone may have removed the file between opening and locking: then this lock
            # locks nothing.
            entry = folder.entry(NAME)
            if entry is not None and os.path.samestat(entry, os.fstat(fd)):
                os.fchmod(fd, _MODE)
                return fd
        except BaseException:
            os.close(fd)
            raise
        os.close(fd)
    raise UsageError(f"{folder.path / NAME} is removed over and over; stop what removes it")


def _open(folder: RuntimeFolder) -> int:
    path = folder.path / NAME
    # O_NONBLOCK: a pipe put there must not hold anybody up.
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    try:
        fd = os.open(NAME, flags, _MODE, dir_fd=folder.fd)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise WriteError(f"cannot write {path}: the disk is full; free some space") from error
        raise UsageError(f"cannot lock {path}: {error.strerror}; remove it") from error
    found = os.fstat(fd)
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
        os.close(fd)
        raise UsageError(f"{path} is no file of user {os.geteuid()}; remove it")
    return fd


def _held(fd: int) -> UsageError:
    """Return the error that names the holder, as far as it has said who it is."""
    who = ""
    with contextlib.suppress(OSError, OverflowError, UsageError):
        holder = from_json(Holder, os.pread(fd, HOLDER_BYTES_MAX, 0))
        # What a dead holder left is there until the next one has written.
        os.kill(max(1, holder.pid), 0)
        started, device = one_line(holder.started, 40), one_line(holder.device, 80)
        who = f" (process {holder.pid}, started {started}, device {device})"
    return UsageError(
        f"another cushion daemon is running{who}; allowed: one a user; "
        "ask it with `cushion status`, or stop it first"
    )

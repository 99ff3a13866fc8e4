"""The daemon's private folder, and the lock that limits each user to one daemon."""

import contextlib
import errno
import fcntl
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.service.json_codec import from_json, to_json
from audioflinger_hook.service.one_line import one_line
from device.errors import CushionError, InternalError, NotFoundError, UsageError, WriteError

VARIABLE = "XDG_RUNTIME_DIR"
FOLDER_NAME = "cushion"
LOCK_NAME = "daemon.lock"
_HOLDER_BYTES_MAX = 4096

_OPEN_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
# The sticky bit protects the file from programs that clean runtime folders.
_LOCK_MODE = stat.S_ISVTX | 0o600
# With O_NONBLOCK, a pipe of this name cannot block the call.
_OPEN_LOCK = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK


class RuntimeFolder(contextlib.AbstractContextManager["RuntimeFolder"]):
    """The open folder `$XDG_RUNTIME_DIR/cushion`. Any thread may use the folder until `close`.

    If the variable is not set, the path is `/run/user/UID/cushion`. Without `/run/user/UID`, the
    path is `cushion-UID` in the folder for temporary files.

    create: whether to create a missing folder. path: path at the time of opening. fd: file
    descriptor, which refers to the same folder even after a rename.

    UsageError: the variable is not a usable path, or the folder is a link, has another owner, or
    is open to others. NotFoundError: it does not exist. InternalError: the disk or system failed.
    """

    def __init__(self, environ: Mapping[str, str], create: bool) -> None:
        self.path = folder_path(environ)
        try:
            if create:
                with contextlib.suppress(FileExistsError):
                    self.path.mkdir(mode=0o700)
            self.fd = os.open(self.path, _OPEN_FOLDER)
        except FileNotFoundError as error:
            raise NotFoundError(f"{self.path} is missing; start `cushion run`") from error
        except OSError as error:
            # With O_NOFOLLOW | O_DIRECTORY, Linux may report ENOTDIR for a link.
            if error.errno in (errno.ELOOP, errno.ENOTDIR):
                raise UsageError(f"{self.path} is a link or not a folder; remove it") from error
            problem = f"cannot open {self.path}: {error.strerror}"
            if error.errno in (errno.ENOSPC, errno.EMFILE, errno.ENFILE, errno.EIO):
                raise InternalError(problem) from error
            raise UsageError(f"{problem}; set {VARIABLE} to a folder of your own") from error
        found = os.fstat(self.fd)
        mode = stat.S_IMODE(found.st_mode)
        if found.st_uid == os.geteuid() and not mode & 0o077:
            return
        self.close()
        if found.st_uid == os.geteuid():
            raise UsageError(f"{self.path} is open to others (mode {mode:04o}); allowed: 0700")
        raise UsageError(
            f"{self.path} belongs to user {found.st_uid}, not to {os.geteuid()}; run as that user, "
            f"or set {VARIABLE} to a folder of your own"
        )

    def address(self, name: str) -> str:
        """Return a socket address in the folder, shorter than Linux's limit of 108 bytes."""
        return f"/proc/self/fd/{self.fd}/{name}"

    def entry(self, name: str) -> os.stat_result | None:
        """Return the `os.stat` result of a directory entry or link, None if missing."""
        try:
            return os.stat(name, dir_fd=self.fd, follow_symlinks=False)
        except FileNotFoundError:
            return None

    def close(self) -> None:
        """Close the descriptor. A second call has no effect."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True)
class Holder:
    """The daemon that holds the lock. started: start time as text. device: the device's address."""

    pid: int
    started: str
    device: str


class DaemonLock(contextlib.AbstractContextManager["DaemonLock"]):
    """The lock that limits each user to one daemon, held until `release` or the end of the process.

    Programs that the daemon starts do not inherit the lock. holder: this daemon, as named in the
    error message of another daemon.

    UsageError: another daemon holds the lock, or the lock file is not a regular file of this user.
    WriteError: the file cannot be written.
    """

    def __init__(self, folder: RuntimeFolder, holder: Holder) -> None:
        self._path = folder.path / LOCK_NAME
        self._fd = _open_locked(folder)
        try:
            self.write(holder)
        except WriteError:
            self.release()
            raise

    def write(self, holder: Holder) -> None:
        """Write the holder to the lock file. WriteError: the file cannot be written."""
        try:
            os.ftruncate(self._fd, 0)
            os.pwrite(self._fd, to_json(holder).encode() + b"\n", 0)
        except OSError as error:
            full = f"cannot write {self._path}: {error.strerror}; free some space"
            raise WriteError(full) from error

    def release(self) -> None:
        """Release the lock and leave an empty file. A second call has no effect."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, 0)
            os.close(self._fd)
            self._fd = -1

    def __exit__(self, *_: object) -> None:
        self.release()


def read_lock(environ: Mapping[str, str]) -> tuple[Holder | None, bool]:
    """Return the daemon that the lock file names, and whether a process holds the lock.

    This reads the kernel's list of locks: to try the lock could stop a daemon that starts now.
    """
    holder, is_locked = None, False
    with contextlib.suppress(CushionError, OSError), RuntimeFolder(environ, create=False) as folder:
        flags = _OPEN_LOCK & ~(os.O_RDWR | os.O_CREAT)
        with os.fdopen(os.open(LOCK_NAME, flags, dir_fd=folder.fd), "rb") as file:
            number = f":{os.fstat(file.fileno()).st_ino} "
            locks = Path("/proc/locks").read_text().splitlines()
            is_locked = any(number in one and "FLOCK" in one for one in locks)
            holder = from_json(Holder, file.read(_HOLDER_BYTES_MAX))
    return holder, is_locked


def folder_path(environ: Mapping[str, str]) -> Path:
    """Return the path of `RuntimeFolder`. UsageError: the variable is not a usable path."""
    user = os.geteuid()
    text = environ.get(VARIABLE, "")
    base = Path(text or f"/run/user/{user}")
    with contextlib.suppress(OSError, ValueError):
        if base.is_absolute() and base.is_dir():
            return base / FOLDER_NAME
    if not text:
        above = Path(environ.get("TMPDIR") or "/tmp")
        if above.is_dir():
            return above / f"{FOLDER_NAME}-{user}"
        raise UsageError(
            f"{VARIABLE} is not set, and TMPDIR is '{above}', which is not a folder; set one of "
            "them to a folder of your own, for the daemon's lock and status socket"
        )
    raise UsageError(
        f"{VARIABLE} is {text!r}, not an absolute path of a folder; set it to a folder of your "
        f"own, usually /run/user/{user}, for the daemon's lock and status socket"
    )


def _open_locked(folder: RuntimeFolder) -> int:
    path = folder.path / LOCK_NAME
    while True:
        try:
            fd = os.open(LOCK_NAME, _OPEN_LOCK, _LOCK_MODE, dir_fd=folder.fd)
        except OSError as error:
            if error.errno == errno.ENOSPC:
                full = f"cannot write {path}: the disk is full; free some space"
                raise WriteError(full) from error
            raise UsageError(f"cannot lock {path}: {error.strerror}; remove it") from error
        with contextlib.ExitStack() as opened:
            opened.callback(os.close, fd)
            found = os.fstat(fd)
            if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
                raise UsageError(f"{path} is not a file of user {os.geteuid()}; remove it")
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise _held(fd) from error
            # If the file was removed before the lock was taken, another daemon can lock a new file.
            entry = folder.entry(LOCK_NAME)
            if entry is not None and os.path.samestat(entry, found):
                os.fchmod(fd, _LOCK_MODE)
                opened.pop_all()
                return fd


def _held(fd: int) -> UsageError:
    """Return the error for a lock that another daemon holds, with the holder if known."""
    who = ""
    with contextlib.suppress(OSError, OverflowError, UsageError):
        holder = from_json(Holder, os.pread(fd, _HOLDER_BYTES_MAX, 0))
        # The file may still name an earlier daemon, whose process does not exist.
        os.kill(max(1, holder.pid), 0)
        started, device = one_line(holder.started, 40), one_line(holder.device, 80)
        who = f" (process {holder.pid}, started {started}, device {device})"
    return UsageError(
        f"another cushion daemon is running{who}; allowed: one per user; "
        "ask it with `cushion status`, or stop it first"
    )

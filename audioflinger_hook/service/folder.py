"""The daemon's folder in $XDG_RUNTIME_DIR: private, ours, and the same one while it is open."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from device.errors import InternalError, NotFoundError, UsageError

VARIABLE = "XDG_RUNTIME_DIR"
NAME = "cushion"
MODE = 0o700
_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class RuntimeFolder:
    """`$XDG_RUNTIME_DIR/cushion`, open: what is done in it stays in it, whatever is renamed.

    path: for people and messages. fd: for calls that take a folder. Any thread may use it until
    it is closed, which whoever opened it does.

    Raises
    ------
    UsageError
        The variable is not set, is no absolute path or names no folder; the folder is a link, not
        ours, or open to others.
    NotFoundError
        The folder does not exist, and `create` is False.
    """

    def __init__(self, environ: Mapping[str, str], create: bool) -> None:
        base = _base(environ)
        self.path = base / NAME
        if create:
            self._create()
        try:
            self.fd = os.open(self.path, _OPEN)
        except FileNotFoundError as error:
            raise NotFoundError(f"there is no folder {self.path}; start `cushion run`") from error
        except OSError as error:
            raise self._refusal(error) from error
        try:
            self._refuse_unless_private()
        except UsageError:
            self.close()
            raise

    def address(self, name: str) -> str:
        """Return the name of a socket in the folder for bind and connect, however deep it lies.

        A socket's address has 108 bytes; this one is short, and its folder cannot be exchanged.
        """
        return f"/proc/self/fd/{self.fd}/{name}"

    def entry(self, name: str) -> os.stat_result | None:
        """Return what stands under a name, a link not followed; None for nothing."""
        try:
            return os.stat(name, dir_fd=self.fd, follow_symlinks=False)
        except FileNotFoundError:
            return None

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold the folder against other processes that start or end a daemon; milliseconds.

        Raises
        ------
        UsageError
            Another process does so just now.
        """
        own = os.open(f"/proc/self/fd/{self.fd}", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            try:
                fcntl.flock(own, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UsageError(
                    f"another daemon starts or ends just now in {self.path}; try again"
                ) from error
            yield
        finally:
            os.close(own)

    def close(self) -> None:
        """Let go of the folder; it stays where it is. May be called more than once."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def __enter__(self) -> RuntimeFolder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _create(self) -> None:
        try:
            self.path.mkdir(mode=MODE)
        except FileExistsError:
            pass
        except OSError as error:
            raise self._refusal(error) from error

    def _refuse_unless_private(self) -> None:
        found = os.fstat(self.fd)
        if found.st_uid != os.geteuid():
            raise UsageError(
                f"{self.path} belongs to user {found.st_uid}, not to {os.geteuid()}; run as that "
                f"user, or set {VARIABLE} to a folder of your own"
            )
        mode = stat.S_IMODE(found.st_mode)
        if mode & 0o077:
            raise UsageError(
                f"{self.path} is open to others (mode {mode:04o}); allowed: 0700; remove it"
            )

    def _refusal(self, error: OSError) -> UsageError | InternalError:
        # With O_NOFOLLOW | O_DIRECTORY a link may be told as "not a directory".
        if error.errno in (errno.ELOOP, errno.ENOTDIR):
            return UsageError(f"{self.path} is a link or no folder; remove it")
        if error.errno in (errno.ENOSPC, errno.EMFILE, errno.ENFILE, errno.EIO):
            return InternalError(f"cannot open {self.path}: {error.strerror}")
        return UsageError(
            f"cannot open {self.path}: {error.strerror}; set {VARIABLE} to a folder of your own"
        )


def _base(environ: Mapping[str, str]) -> Path:
    text = environ.get(VARIABLE, "")
    advice = f"set it to a folder of your own, usually /run/user/{os.geteuid()}"
    if not text:
        raise UsageError(f"{VARIABLE} is not set; {advice}")
    base = Path(text)
    if not base.is_absolute():
        raise UsageError(f"{VARIABLE} is {text!r}, which is no absolute path; {advice}")
    try:
        found = base.is_dir()
    except (OSError, ValueError):
        found = False
    if not found:
        raise UsageError(f"{VARIABLE} is {text!r}, which is no folder; {advice}")
    return base

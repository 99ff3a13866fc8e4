"""A private directory of one process, removed even if the process is killed.

The process holds a lock on it, which the kernel releases when the process ends. The next process
that makes such a directory removes those that are not locked.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from device.errors import UsageError

PREFIX = "cushion-alsa-"
_ATTEMPTS = 10
_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class PrivateDir:
    """A new directory that only this user may enter, held until `close`. For one thread.

    inside: its parent, made if missing. None stands for $XDG_RUNTIME_DIR/cushion, or the directory
    for temporary files where that is not possible. path: of the directory. UsageError: no directory
    can be made there.
    """

    def __init__(self, inside: Path | None = None) -> None:
        parent = inside or runtime_dir() or Path(tempfile.gettempdir())
        try:
            parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            remove_stale(parent)
            self.path, self._lock_file = _make(parent)
        except OSError as error:
            raise UsageError(
                f"the ALSA configuration cannot be written to {parent} ({error.strerror}); set "
                "XDG_RUNTIME_DIR or TMPDIR to a folder that can be written"
            ) from None

    def close(self) -> None:
        """Remove the directory with its content. May be repeated; raises nothing."""
        if self._lock_file >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock_file)
            self._lock_file = -1


def runtime_dir() -> Path | None:
    """Return $XDG_RUNTIME_DIR/cushion, made if missing; None if other users may enter it."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    if not base.startswith("/") or set(base) & set(" :"):  # where ALSA splits a path
        return None
    folder = Path(base) / "cushion"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except (OSError, ValueError):
        return None
    private = stat.S_ISDIR(found.st_mode) and not stat.S_IMODE(found.st_mode) & 0o077
    return folder if private and found.st_uid == os.geteuid() else None


def remove_stale(parent: Path) -> int:
    """Remove this user's directories that no process holds, and count them; raises nothing."""
    with suppress(OSError):
        return sum(map(_remove_if_stale, list(parent.glob(f"{PREFIX}*"))))
    return 0


def _remove_if_stale(folder: Path) -> bool:
    try:
        held = os.open(folder, _OPEN)
    except OSError:
        return False
    try:
        if os.fstat(held).st_uid != os.geteuid():
            return False
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
        return True
    except OSError:  # a process holds it
        return False
    finally:
        os.close(held)


def _make(parent: Path) -> tuple[Path, int]:
    """Return a new directory and the descriptor that locks it."""
    for _ in range(_ATTEMPTS):
        path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        try:
            held = os.open(path, _OPEN)
        except FileNotFoundError:
            continue
        fcntl.flock(held, fcntl.LOCK_EX)
        # Another process may have removed it before it was locked.
        with suppress(FileNotFoundError):
            if os.path.samestat(path.lstat(), os.fstat(held)):
                return path, held
        os.close(held)
    raise UsageError(f"another program keeps removing directories in {parent}; stop that program")

"""A folder of one process for files of its own, which is removed even if the process is killed.

It is locked as long as the process lives, by a lock that the kernel lets go of however it dies.
Whoever makes the next one removes those that nobody holds.
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
    """A new folder that nobody else may enter, held until `close`.

    inside: where it is made, itself made if missing; None for $XDG_RUNTIME_DIR/cushion, or where
    that cannot be had, the folder for temporary files. path: the folder's. Made and closed by one
    thread.

    Raises
    ------
    UsageError
        No folder can be made there.
    """

    def __init__(self, inside: Path | None = None) -> None:
        place = inside or runtime_dir() or Path(tempfile.gettempdir())
        try:
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            sweep(place)
            self.path, self._held = _made(place)
        except OSError as error:
            raise UsageError(
                f"the ALSA configuration cannot be written to {place} ({error.strerror}); set "
                "XDG_RUNTIME_DIR or TMPDIR to a folder that can be written"
            ) from None

    def close(self) -> None:
        """Remove the folder with all that is in it. Again too; it raises nothing."""
        if self._held >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._held)
            self._held = -1


def runtime_dir() -> Path | None:
    """Return $XDG_RUNTIME_DIR/cushion, made if missing; None where it is not ours alone.

    ALSA takes blanks and colons in the path of a configuration for the beginning of another one:
    a folder with these in its name is none.
    """
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    if not base.startswith("/") or set(base) & set(" :"):
        return None
    folder = Path(base) / "cushion"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except (OSError, ValueError):
        return None
    private = stat.S_ISDIR(found.st_mode) and not stat.S_IMODE(found.st_mode) & 0o077
    return folder if private and found.st_uid == os.geteuid() else None


def sweep(place: Path) -> int:
    """Remove the folders of ours that no process holds any more; how many there were.

    Those of other users stay. It raises nothing.
    """
    swept = 0
    with suppress(OSError):
        for folder in place.glob(f"{PREFIX}*"):
            swept += _swept(folder)
    return swept


def _swept(folder: Path) -> bool:
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
    except OSError:  # somebody holds it
        return False
    finally:
        os.close(held)


def _made(place: Path) -> tuple[Path, int]:
    """Return a new folder and the descriptor that holds it."""
    for _ in range(_ATTEMPTS):
        path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
        try:
            held = os.open(path, _OPEN)
        except FileNotFoundError:
            continue
        fcntl.flock(held, fcntl.LOCK_EX)
        # Somebody may have swept it before it was held.
        with suppress(FileNotFoundError):
            if os.path.samestat(path.lstat(), os.fstat(held)):
                return path, held
        os.close(held)
    raise UsageError(f"{place} is tidied up over and over; stop what does that")

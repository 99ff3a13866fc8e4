"""Temporary folders. If a process is killed, a later one on the same computer deletes them."""

import fcntl
import glob
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# Other computers do not see a lock on a shared folder, so each deletes only its own folders.
PREFIX = f".cushion-run-{platform.node()}-"


@contextmanager
def temporary_folder(above: str | Path | None = None) -> Iterator[Path]:
    """Yield a new folder, and delete it at the end. above: its parent folder; default: TMPDIR."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=above))
        with suppress(FileNotFoundError):  # another process has just taken it for abandoned
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            with suppress(OSError):  # the file system has no locks
                fcntl.flock(lock, fcntl.LOCK_EX)
            if folder.exists():
                break
            os.close(lock)
    owner = os.getpid()
    try:
        yield folder
    finally:
        if os.getpid() == owner:  # not in a fork of this process
            shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def delete_abandoned_folders(above: Path | None = None) -> None:
    """Delete the folders in `above`, or TMPDIR and /tmp, that ended processes have left."""
    places = [above] if above else {Path(tempfile.gettempdir()), Path("/tmp")}
    for folder in [one for place in places for one in place.glob(f"{glob.escape(PREFIX)}*")]:
        with suppress(OSError):  # it is in use, or another process deletes it
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(lock).st_uid == os.getuid():
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)

"""Files that appear complete at their path, or not at all; and temporary folders.

On Linux the content is first written to an unnamed file (O_TMPFILE). The file gets its name last,
so that even kill -9 leaves no partial file. If the filesystem does not support O_TMPFILE, a hidden
file `.NAME.XXXX.part` is written first. This hidden file may remain after kill -9. If a process is
killed, a later one on the same computer deletes its temporary folders.
"""

import base64
import errno
import fcntl
import glob
import os
import platform
import shutil
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from device.errors import CushionError, UsageError, WriteError

# errors of the disk or the machine, not of the user
MACHINE_FAULTS = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE}

_REASONS = {
    errno.ENOSPC: "the disk is full; free some space or name another folder",
    errno.EDQUOT: "the disk quota is used up; free some space or name another folder",
    errno.EFBIG: "the file would be larger than allowed; raise the limit (ulimit -f)",
    errno.EROFS: "the file system is read-only; name another folder",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
}
_FLAGS = os.O_RDWR | os.O_CLOEXEC
_FOLDER_FLAGS = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC
_MODE = 0o666  # reduced by the umask


class AtomicFile(AbstractContextManager["AtomicFile"]):
    """A new file that appears at `path` only when `commit` succeeds.

    Before `commit`, and after `abort` or kill -9, an existing file at `path` is unchanged. A `with`
    block calls `commit` at its end, or `abort` after an exception. If `path` is a symbolic link,
    the target of the link is replaced. The new file gets the mode, owner and extended attributes of
    `model`, or else of the file that it replaces, as far as this user may set them. One thread at a
    time may use the object. UsageError: no file can be written at `path`, for example because its
    folder is missing. WriteError: writing failed, for example because the disk is full. A method
    that raises WriteError has already called `abort`.
    """

    def __init__(self, path: str | os.PathLike[str], model: Path | None = None) -> None:
        self.path = Path(path)
        self._file_fd = self._folder_fd = -1
        self._part: str | None = None
        try:
            _refuse_unless_regular(self.path)
            target = self.path.resolve()
            self._name = target.name
            self._folder_fd = os.open(target.parent, _FOLDER_FLAGS)
            self._open_file()
            self._keep_rights(model or target)
        except (OSError, ValueError) as error:
            self.abort()
            raise _open_failure(self.path, error) from error

    def write(self, content: bytes | memoryview) -> None:
        """Append all of the content, or raise WriteError."""
        rest = memoryview(content).cast("B")
        try:
            while rest:
                rest = rest[os.write(self._file_fd, rest) :]
        except OSError as error:
            raise self._failure(error) from error

    def overwrite(self, content: bytes, position: int = 0) -> None:
        """Overwrite the file from offset `position` on; later calls of `write` still append."""
        try:
            written = os.pwrite(self._file_fd, content, position)
        except OSError as error:
            raise self._failure(error) from error
        if written != len(content):
            raise self._failure(OSError(errno.EIO, "short write"))

    def size(self) -> int:
        """Length of the file in bytes."""
        return os.fstat(self._file_fd).st_size

    def commit(self, *, sync: bool = True) -> None:
        """Put the file at `path`. Without `sync`, a power failure may leave an incomplete file."""
        if self._file_fd < 0:
            raise WriteError(f"cannot write {self.path}: it was closed before")
        folder = self._folder_fd
        try:
            if sync:
                os.fsync(self._file_fd)
            if self._part is None:
                try:
                    self._link_as(self._name)
                except FileExistsError:
                    # link(2) cannot replace a file: use a temporary name, then rename.
                    self._part = self._part_name()
                    self._link_as(self._part)
            if self._part is not None:
                os.replace(self._part, self._name, src_dir_fd=folder, dst_dir_fd=folder)
                self._part = None
        except OSError as error:
            raise self._failure(error) from error
        self.abort()  # nothing is left to discard, so this only closes

    def abort(self) -> None:
        """Discard the new file. After `commit` or `abort`, this has no effect."""
        if self._part is not None:
            with suppress(OSError):  # the folder may be deleted
                os.unlink(self._part, dir_fd=self._folder_fd)
            self._part = None
        for fd in (self._file_fd, self._folder_fd):
            if fd >= 0:
                os.close(fd)
        self._file_fd = self._folder_fd = -1

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.commit()
        else:
            self.abort()

    def _open_file(self) -> None:
        if (nameless := getattr(os, "O_TMPFILE", 0)) and Path("/proc/self/fd").is_dir():
            try:
                self._file_fd = os.open(".", nameless | _FLAGS, _MODE, dir_fd=self._folder_fd)
                return
            except OSError as error:
                # EISDIR: the kernel does not know O_TMPFILE. EINVAL, ENOENT: FUSE and others.
                unsupported = {errno.EOPNOTSUPP, errno.EISDIR, errno.ENOSYS, errno.EINVAL}
                if error.errno not in unsupported | {errno.ENOENT}:
                    raise
        part = self._part_name()
        flags = _FLAGS | os.O_CREAT | os.O_EXCL
        self._file_fd = os.open(part, flags, _MODE, dir_fd=self._folder_fd)
        self._part = part

    def _keep_rights(self, model: Path) -> None:
        with suppress(OSError):  # there is none, or it has no extended attributes
            found = model.stat()
            for uid, gid in ((-1, found.st_gid), (found.st_uid, -1)):
                with suppress(OSError):  # only root may give a file away
                    os.chown(self._file_fd, uid, gid)
            os.fchmod(self._file_fd, found.st_mode & 0o777)
            for name in os.listxattr(model):  # such as access control lists
                with suppress(OSError):
                    os.setxattr(self._file_fd, name, os.getxattr(model, name))

    def _part_name(self) -> str:
        # The name may already have the maximum length of 255 bytes.
        start = os.fsdecode(os.fsencode(self._name)[:200])
        return f".{start}.{os.urandom(4).hex()}.part"

    def _link_as(self, name: str) -> None:
        # linkat(2) must follow the link in /proc; Python calls linkat only if dst_dir_fd is given.
        source = f"/proc/self/fd/{self._file_fd}"
        os.link(source, name, dst_dir_fd=self._folder_fd, follow_symlinks=True)

    def _failure(self, error: OSError) -> WriteError:
        self.abort()
        return WriteError(f"cannot write {self.path}: {write_reason(error)}")


def write_bytes_atomically(
    path: str | os.PathLike[str], content: bytes, model: Path | None = None
) -> None:
    """Write `content` with an `AtomicFile`: after an error, an existing file is unchanged.

    model: a file whose rights the new file gets.
    """
    with AtomicFile(path, model) as file:
        file.write(content)


def write_private(path: Path, content: bytes) -> None:
    """Write a file atomically; make its folder, if it is missing, for this user only."""
    make_private_folder(path.parent)
    write_bytes_atomically(path, content)


def remove_file(path: Path) -> None:
    """Remove a file or link, if there is one. UsageError: it cannot be removed."""
    try:
        with suppress(NotADirectoryError):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(f"cannot remove {path}: {error.strerror}; remove it yourself") from error


def _refuse_unless_regular(path: Path) -> None:
    if not path.name:
        raise UsageError(f"cannot write {str(path)!r}: it has no file name; name a file")
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise UsageError(f"cannot write {path}: it is a folder; name a file in it")
    if not stat.S_ISREG(mode):
        raise UsageError(f"cannot write {path}: it is not a regular file; name another file")
    if not os.access(path, os.W_OK, effective_ids=os.access in os.supports_effective_ids):
        raise UsageError(f"cannot write {path}: it is write-protected; name another file")


def _open_failure(path: Path, error: OSError | ValueError) -> CushionError:
    if not isinstance(error, OSError):  # a name with a null byte
        return UsageError(f"cannot write {str(path)!r}: {error}; choose another name")
    if error.errno == errno.ENOENT:
        folder = path.resolve().parent
        return UsageError(
            f"cannot write {path}: folder {folder} does not exist; create it or name another"
        )
    if error.errno == errno.ENOTDIR:
        return UsageError(f"cannot write {path}: {path.parent} is not a folder; name a folder")
    if error.errno in (errno.EACCES, errno.EPERM):
        return UsageError(
            f"cannot write {path}: no permission to write in folder {path.parent}; name another"
        )
    if error.errno in MACHINE_FAULTS:
        return WriteError(f"cannot write {path}: {write_reason(error)}")
    return UsageError(f"cannot write {path}: {write_reason(error)}")


def write_reason(error: OSError) -> str:
    """Return why a file cannot be written, and the remedy."""
    return _REASONS.get(error.errno or 0, f"{error.strerror or error}; name another folder")


def make_private_folder(folder: Path) -> None:
    """Make a folder that only this user can access; missing parents get the default rights.

    An existing folder keeps its rights. UsageError: the folder cannot be made.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        in_way = isinstance(error, (FileExistsError, NotADirectoryError))
        advice = "rename or remove the file in its place" if in_way else "make it yourself"
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}; {advice}") from error


# Other computers do not see a lock on a shared folder, so each deletes only its own folders.
PREFIX = f".cushion-run-{zlib.crc32(os.fsencode(platform.node())):08x}-"


@contextmanager
def temporary_folder(above: str | Path | None = None) -> Iterator[Path]:
    """Yield a new folder, and delete it at the end. above: its parent folder; default: TMPDIR."""
    parent = Path(above or tempfile.gettempdir())
    folder, owner, lock = parent / PREFIX, os.getpid(), -1
    try:  # an interrupt may come at any moment, also in `mkdir` or in `rmtree`
        while lock < 0 or not folder.exists():  # another process may take it for abandoned
            folder = parent / (PREFIX + base64.urlsafe_b64encode(os.urandom(6)).decode())
            folder.mkdir(0o700)
            with suppress(FileNotFoundError):
                lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
                with suppress(OSError):  # the file system has no locks
                    fcntl.flock(lock, fcntl.LOCK_EX)
        yield folder
    finally:
        if os.getpid() == owner:  # not in a fork of this process
            try:
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
        if lock >= 0:
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

"""Files that appear complete at their path, or not at all.

On Linux the content is written to a file without a name (O_TMPFILE), which gets its name last, so
even kill -9 leaves nothing behind. If the filesystem cannot do that (some overlay and network
filesystems), the content goes to a hidden `.NAME.XXXX.part` in the same folder. Only kill -9 leaves
it.
"""

import contextlib
import errno
import os
import stat
from pathlib import Path

from device.errors import CushionError, UsageError, WriteError

MACHINE_FAULTS = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE}
"""Errors of the disk or the machine, not of the user."""

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


class AtomicFile:
    """A new file that appears at `path` only after `commit` returns.

    Until then, and after `abort` or kill -9, an existing file of that name is unchanged. As a
    context manager, it commits, or aborts on an exception. A link is followed: the file it points
    to is replaced. Use from one thread at a time.

    UsageError: there is no such folder, or the folder or the file there cannot be written, or the
    path is a folder or a device. WriteError: the disk is full or failed. Methods raise it, too, and
    have then aborted.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._file_fd = self._folder_fd = -1
        self._part: str | None = None
        try:
            _refuse_unless_regular(self.path)
            target = self.path.resolve()
            self._name = target.name
            self._folder_fd = os.open(target.parent, _FOLDER_FLAGS)
            self._open_file()
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
        """Overwrite bytes from a position on; later writes still go to the file's end."""
        try:
            written = os.pwrite(self._file_fd, content, position)
        except OSError as error:
            raise self._failure(error) from error
        if written != len(content):
            raise self._failure(OSError(errno.EIO, "short write"))

    def size(self) -> int:
        """Bytes in the file, as the filesystem counts them."""
        return os.fstat(self._file_fd).st_size

    def commit(self, *, sync: bool = True) -> None:
        """Sync the content, then give the file its name, in place of an old file.

        Without `sync`, a power failure soon after may leave a file that is not whole.
        """
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
        """Discard everything; no effect after `commit` or `abort`."""
        if self._part is not None:
            with contextlib.suppress(OSError):  # the file may be gone with its folder
                os.unlink(self._part, dir_fd=self._folder_fd)
            self._part = None
        for fd in (self._file_fd, self._folder_fd):
            if fd >= 0:
                os.close(fd)
        self._file_fd = self._folder_fd = -1

    def __enter__(self) -> "AtomicFile":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.commit()
        else:
            self.abort()

    def _open_file(self) -> None:
        nameless = getattr(os, "O_TMPFILE", 0)
        if nameless and Path("/proc/self/fd").is_dir():
            try:
                self._file_fd = os.open(".", nameless | _FLAGS, _MODE, dir_fd=self._folder_fd)
                return
            except OSError as error:
                # EISDIR: a kernel that does not know the flag; EINVAL, ENOENT: FUSE and others.
                unsupported = {errno.EOPNOTSUPP, errno.EISDIR, errno.ENOSYS, errno.EINVAL}
                if error.errno not in unsupported | {errno.ENOENT}:
                    raise
        part = self._part_name()
        flags = _FLAGS | os.O_CREAT | os.O_EXCL
        self._file_fd = os.open(part, flags, _MODE, dir_fd=self._folder_fd)
        self._part = part

    def _part_name(self) -> str:
        # The name may already have the 255 bytes that a folder entry can have.
        start = os.fsdecode(os.fsencode(self._name)[:200])
        return f".{start}.{os.urandom(4).hex()}.part"

    def _link_as(self, name: str) -> None:
        # Only linkat(2) follows the link in /proc; Python calls it only if given a folder.
        source = f"/proc/self/fd/{self._file_fd}"
        os.link(source, name, dst_dir_fd=self._folder_fd, follow_symlinks=True)

    def _failure(self, error: OSError) -> WriteError:
        self.abort()
        return WriteError(f"cannot write {self.path}: {write_reason(error)}")


def write_bytes_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a complete file, or leave it unchanged and raise an error of `AtomicFile`."""
    with AtomicFile(path) as file:
        file.write(content)


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
    """Return why a file cannot be written, and what to do."""
    return _REASONS.get(error.errno or 0, f"{error.strerror or error}; name another folder")


def make_private_folder(folder: Path) -> None:
    """Make a folder, and those above it, for this user alone. UsageError: it cannot be made."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"cannot make the folder {folder}: {error.strerror}; make it yourself"
        ) from error

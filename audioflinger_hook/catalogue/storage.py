"""Access to results and sounds, on this machine or in remote storage.

A result appears only when it is complete: its file is renamed, or uploaded in one request. A JSON
file beside the result, its record, describes it. Before a result is replaced, its old record is
deleted. The new record is written last, so a record never describes another result.
"""

import hashlib
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from audioflinger_hook.catalogue.addresses import filesystem_of, is_url, remote_errors, scrubbed
from audioflinger_hook.catalogue.timing import StorageError, UnreadableError
from device.atomic_file import AtomicFile, delete_abandoned_folders, temporary_folder
from device.errors import UsageError, WriteError

T = TypeVar("T")

RECORD = ".json"  # suffix of a record's name, after the name of its result

# In these storages, an upload appears only when complete. In all others, the upload is renamed.
ATOMIC = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "memory"})

ETAGS = (  # names, in several storages, of attributes that change with a file's content
    "ETag", "etag", "md5Hash", "content_md5", "generation", "version", "VersionId", "mtime",
    "LastModified", "last_modified", "modified", "updated", "created",
)  # fmt: skip


@dataclass(frozen=True)
class Stamp:
    """Values that change with a file's content. size: bytes; None: unknown. stamp: time or ETag."""

    size: int | None
    stamp: str


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"cannot make the folder {folder}: {error.strerror}") from error


class LocalStorage:
    """A local folder of results. Any thread may call the methods. `name`: path in the folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._tidy: set[Path] = set()  # folders without remains of ended processes

    def prepare(self) -> None:
        """Make the folder if it is missing. UsageError: it cannot be made, or is not writable."""
        root = self._root
        try:
            root.mkdir(exist_ok=True)
        except OSError as error:
            above = "" if root.parent.is_dir() else f"; the folder {root.parent} is missing"
            raise UsageError(
                f"the output folder {root} cannot be made ({error.strerror}){above}"
            ) from None
        if not os.access(root, os.W_OK | os.X_OK):
            raise UsageError(f"the output folder {root} is not writable; name another")

    def stamp(self, name: str) -> Stamp | None:
        """Return the `Stamp` of a file; None if there is no file."""
        path = f"{self._root}/{name}"
        with _if_present(path):
            return _local_stamp(path)
        return None

    def read(self, name: str) -> bytes | None:
        """Return the content of a small file; None if there is no file."""
        path = f"{self._root}/{name}"
        with _if_present(path):
            file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # may be a pipe
            with os.fdopen(file, "rb", 0) as opened:
                return opened.read() or b""
        return None

    def write(self, name: str, content: bytes) -> None:
        """Write a small file. A power failure may leave part of the file, which readers detect."""
        path = self._root / name
        _make_folder(path.parent)
        file = AtomicFile(path)
        file.write(content)
        file.commit(sync=False)

    def delete(self, name: str) -> None:
        """Delete a file if it exists."""
        with suppress(FileNotFoundError, NotADirectoryError):
            (self._root / name).unlink()

    def put(self, name: str, make: Callable[[Path], T]) -> tuple[T, Stamp, str]:
        """Call `make` to write a file; then delete the old record and rename the file to `name`.

        Return the result of `make`, the file's stamp and its SHA-256.
        """
        target = self._root / name
        _make_folder(target.parent)
        try:
            if target.parent not in self._tidy:
                self._tidy.add(target.parent)
                delete_abandoned_folders(target.parent)
            with temporary_folder(target.parent) as folder:
                part = folder / f"result{target.suffix}"
                result = make(part)
                stamp, sha256 = _local_stamp(part), digest(part)
                self.delete(name + RECORD)
                part.replace(target)
        except OSError as error:
            raise WriteError(f"cannot write {target}: {error.strerror or error}") from error
        return result, stamp, sha256

    def restamped(self, name: str, sha256: str) -> str | None:
        """Return a file's present `Stamp.stamp` if its SHA-256 equals `sha256`, else None."""
        path = self._root / name
        return _local_stamp(path).stamp if digest(path) == sha256 else None


class _RemoteStorage:
    """A folder at a URL that fsspec knows, with the interface of `LocalStorage`."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._files, self._root = filesystem_of(url)
        self._atomic = url.partition("://")[0].lower() in ATOMIC

    def prepare(self) -> None:
        with remote_errors(scrubbed(self._url), StorageError):
            self._files.makedirs(self._root, exist_ok=True)

    def stamp(self, name: str) -> Stamp | None:
        with self._errors(name), suppress(FileNotFoundError):
            return _remote_stamp(self._files.info(self._path(name)))
        return None

    def read(self, name: str) -> bytes | None:
        with self._errors(name), suppress(FileNotFoundError):
            return bytes(self._files.cat_file(self._path(name)))
        return None

    def write(self, name: str, content: bytes) -> None:
        with temporary_folder() as folder:
            path = folder / "upload"
            path.write_bytes(content)
            self._upload(path, name)

    def delete(self, name: str) -> None:
        with self._errors(name), suppress(FileNotFoundError):
            self._files.rm_file(self._path(name))

    def put(self, name: str, make: Callable[[Path], T]) -> tuple[T, Stamp, str]:
        with temporary_folder() as folder:
            path = folder / f"result{PurePosixPath(name).suffix}"
            result = make(path)
            size, sha256 = path.stat().st_size, digest(path)
            self.delete(name + RECORD)
            self._upload(path, name)
        found = self.stamp(name)
        if found is None or found.size not in (None, size):
            raise StorageError(f"{self._shown(name)} is not whole after its upload; try again")
        return result, Stamp(size, found.stamp), sha256

    def restamped(self, _name: str, _sha256: str) -> None:
        """Return None: checking the SHA-256 needs a download, so the result is made again."""

    def _upload(self, path: Path, name: str) -> None:
        target = self._path(name)
        with self._errors(name):
            if self._atomic:
                self._files.put_file(str(path), target)
                return
            parent = target.rpartition("/")[0]
            part = f"{parent}/.{secrets.token_hex(6)}.part"
            self._files.makedirs(parent, exist_ok=True)
            try:
                self._files.put_file(str(path), part)
                self._files.mv(part, target)
            except BaseException:
                with suppress(Exception):
                    self._files.rm_file(part)
                raise

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _shown(self, name: str) -> str:
        return scrubbed(f"{self._url}/{name}")

    def _errors(self, name: str) -> AbstractContextManager[None]:
        return remote_errors(self._shown(name), StorageError)


Storage = LocalStorage | _RemoteStorage


def storage_of(address: str) -> Storage:
    """Return the storage at an address. address: result of `parse_address`."""
    return _RemoteStorage(address) if is_url(address) else LocalStorage(Path(address))


def identity_of(audio: str) -> Stamp | None:
    """Return the `Stamp` of a sound; None if a local file cannot be read."""
    if is_url(audio):
        filesystem, inside = filesystem_of(audio)
        with remote_errors(scrubbed(audio), UnreadableError):
            return _remote_stamp(filesystem.info(inside))
    try:
        found = os.stat(audio)  # noqa: PTH116
    except (OSError, ValueError):
        return None
    return Stamp(found.st_size, str(found.st_mtime_ns))


@contextmanager
def local_copy(audio: str) -> Iterator[Path]:
    """Yield a local path of a sound. The copy of a remote sound is deleted afterwards."""
    if not is_url(audio):
        yield Path(audio)
        return
    filesystem, inside = filesystem_of(audio)
    with temporary_folder() as folder:
        path = folder / f"sound{PurePosixPath(inside).suffix}"
        with remote_errors(scrubbed(audio), UnreadableError):
            filesystem.get_file(inside, str(path))
        yield path


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's content. OSError: the file cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a user's file. UsageError: the file cannot be read."""
    try:
        return digest(path)
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror})") from error


@contextmanager
def _if_present(path: str) -> Iterator[None]:
    """Ignore that a file is missing. UsageError: it cannot be used for another reason."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); check or delete it") from error


def _local_stamp(path: str | Path) -> Stamp:
    found = os.stat(path)  # noqa: PTH116
    return Stamp(found.st_size, f"{found.st_mtime_ns}-{found.st_ino}")


def _remote_stamp(info: dict[str, Any]) -> Stamp:
    found = [f"{name}={info[name]}" for name in ETAGS if info.get(name)]
    size = info.get("size")
    return Stamp(None if size is None else int(size), found[0] if found else "")

"""The folder of the results and the sounds, on this machine or in a remote storage.

A result is made under a hidden name and renamed, or uploaded in one request: it appears whole or
not at all. Its record is deleted before a new result appears, and written after it. A record also
says how the result's file is known again (`stamp`), so it never describes another file's bytes.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Protocol, TypeVar

from audioflinger_hook.catalogue.addresses import filesystem_of, is_url, remote_errors, scrubbed
from audioflinger_hook.catalogue.stamps import Stamp, digest, local_stamp, remote_stamp
from audioflinger_hook.catalogue.timing import StorageError, UnreadableError
from device.atomic_file import AtomicFile
from device.errors import UsageError, WriteError

T = TypeVar("T")

RECORD = ".json"
"""Ending of a record's name, after the name of its result."""

PART = ".part+"
"""How the name of a result under way begins. Host, the numbering of its processes, process and a
random number follow: containers of one host number their processes on their own."""

ATOMIC = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "memory"})
"""Storages in which an upload appears whole; elsewhere it is uploaded and then renamed."""


@cache
def _machine_start() -> str:
    """Return how the names of parts begin that processes make which this one can see."""
    numbering = 0
    with contextlib.suppress(OSError):
        numbering = Path("/proc/self/ns/pid").stat().st_ino
    return f"{PART}{socket.gethostname()}+{numbering}+"


def _part_start(process: int) -> str:
    return f"{_machine_start()}{process}+"


@dataclass(frozen=True)
class Made:
    """A result that was put in its place: its size, its stamp and its SHA-256."""

    size: int
    stamp: str
    sha256: str


class Storage(Protocol):
    """A folder of results. Any thread; names are relative paths."""

    def prepare(self) -> None:
        """Make the folder if it is missing. UsageError: this is not possible."""
        ...

    def stamp(self, name: str) -> Stamp | None:
        """Return what a file is known by, None if there is none."""
        ...

    def read(self, name: str) -> bytes | None:
        """Return the content of a small file, None if there is none."""
        ...

    def write(self, name: str, content: bytes) -> None:
        """Write a small file, whole or not at all."""
        ...

    def delete(self, name: str) -> None:
        """Delete a file, if there is one."""
        ...

    def put(self, name: str, make: Callable[[Path], T]) -> tuple[T, Made]:
        """Make a result and put it in its place; its record is deleted before.

        make: writes the file at a path, which has the ending of the name.
        """
        ...

    def restamped(self, name: str, sha256: str) -> str | None:
        """Return the stamp of a file that has this SHA-256; None if it has not, or is remote."""
        ...


def storage_of(address: str) -> Storage:
    """Return the storage of an address from `parse_address`."""
    return RemoteStorage(address) if is_url(address) else LocalStorage(Path(address))


class LocalStorage:
    """A folder of this machine.

    Parameters
    ----------
    root : Path
        The folder, absolute.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._tidy: set[Path] = set()  # folders without parts of dead processes

    def prepare(self) -> None:
        """Make the folder, if the folder above it exists."""
        try:
            self._root.mkdir(exist_ok=True)
        except OSError as error:
            above = (
                "" if self._root.parent.is_dir() else f"; the folder {self._root.parent} is missing"
            )
            raise UsageError(
                f"the output folder {self._root} cannot be made ({error.strerror}){above}"
            ) from None
        if not os.access(self._root, os.W_OK | os.X_OK):
            raise UsageError(f"the output folder {self._root} is not writable; name another")

    def stamp(self, name: str) -> Stamp | None:
        """Return size, time and number of a file."""
        try:
            return local_stamp(self._root / name)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def read(self, name: str) -> bytes | None:
        """Return a file's content."""
        try:
            return (self._root / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file without waiting for the disk: a torn record is not believed."""
        file = AtomicFile(self._root / name)
        file.write(content)
        file.commit(sync=False)

    def delete(self, name: str) -> None:
        """Delete a file."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            (self._root / name).unlink()

    def put(self, name: str, make: Callable[[Path], T]) -> tuple[T, Made]:
        """Make a result beside its place, and rename it."""
        target = self._root / name
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"cannot make the folder {target.parent}: {error.strerror}") from error
        part = target.with_name(f"{_part_start(os.getpid())}{secrets.token_hex(6)}{target.suffix}")
        try:
            self._tidy_up(target.parent)
            result = make(part)
            stamp, sha256 = local_stamp(part), digest(part)
            self.delete(name + RECORD)
            part.replace(target)
        except OSError as error:
            raise WriteError(f"cannot write {target}: {error.strerror or error}") from error
        finally:
            part.unlink(missing_ok=True)
        return result, Made(stamp.size or 0, stamp.stamp, sha256)

    def _tidy_up(self, folder: Path) -> None:
        """Delete, once, what processes of this machine were making there when they were killed."""
        if folder in self._tidy:
            return
        self._tidy.add(folder)
        # Some file systems have parts of parts, see `AtomicFile`: a dot and the name, and more.
        start = _machine_start()
        for part in [*folder.glob(f"{start}*"), *folder.glob(f".{start}*")]:
            process = part.name.split("+")[-2]
            if process.isdigit() and not Path("/proc", process).exists():
                part.unlink(missing_ok=True)

    def restamped(self, name: str, sha256: str) -> str | None:
        """Return the stamp of a copy of the same bytes."""
        path = self._root / name
        return local_stamp(path).stamp if digest(path) == sha256 else None


class RemoteStorage:
    """A folder behind a URL that fsspec knows.

    Parameters
    ----------
    url : str
        The folder, without credentials.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._files, self._root = filesystem_of(url)
        self._atomic = url.partition("://")[0].lower() in ATOMIC

    def prepare(self) -> None:
        """Make the folder where folders exist."""
        with self._errors(self._url):
            self._files.makedirs(self._root, exist_ok=True)

    def stamp(self, name: str) -> Stamp | None:
        """Return size and etag of a file, or what the storage has in place of an etag."""
        with self._errors(name):
            try:
                return remote_stamp(self._files.info(self._path(name)))
            except FileNotFoundError:
                return None

    def read(self, name: str) -> bytes | None:
        """Return a file's content."""
        with self._errors(name):
            try:
                content: bytes = self._files.cat_file(self._path(name))
                return content
            except FileNotFoundError:
                return None

    def write(self, name: str, content: bytes) -> None:
        """Upload a small file."""
        with tempfile.TemporaryDirectory(prefix="cushion-") as folder:
            path = Path(folder) / "upload"
            path.write_bytes(content)
            self._upload(path, name)

    def delete(self, name: str) -> None:
        """Delete a file."""
        with self._errors(name), contextlib.suppress(FileNotFoundError):
            self._files.rm_file(self._path(name))

    def put(self, name: str, make: Callable[[Path], T]) -> tuple[T, Made]:
        """Make a result in a temporary folder, and upload it."""
        with tempfile.TemporaryDirectory(prefix="cushion-") as folder:
            path = Path(folder) / f"result{PurePosixPath(name).suffix}"
            result = make(path)
            size, sha256 = path.stat().st_size, digest(path)
            self.delete(name + RECORD)
            self._upload(path, name)
        found = self.stamp(name)
        if found is None or found.size not in (None, size):
            raise StorageError(f"{self._shown(name)} is not whole after its upload; try again")
        return result, Made(size, found.stamp, sha256)

    def restamped(self, name: str, sha256: str) -> str | None:
        """Return None: rendering is hardly dearer than a download."""
        return None

    def _upload(self, path: Path, name: str) -> None:
        target = self._path(name)
        with self._errors(name):
            if self._atomic:
                self._files.put_file(str(path), target)
                return
            parent, _, last = target.rpartition("/")
            part = f"{parent}/.{secrets.token_hex(6)}.part"
            self._files.makedirs(parent, exist_ok=True)
            try:
                self._files.put_file(str(path), part)
                self._files.mv(part, f"{parent}/{last}")
            except BaseException:
                with contextlib.suppress(Exception):
                    self._files.rm_file(part)
                raise

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _shown(self, name: str) -> str:
        return scrubbed(name if is_url(name) else f"{self._url}/{name}")

    @contextmanager
    def _errors(self, name: str) -> Iterator[None]:
        with remote_errors(self._shown(name), StorageError):
            yield


@contextmanager
def local_copy(audio: str) -> Iterator[Path]:
    """Yield the path of a sound; a remote one is downloaded and removed afterwards."""
    if not is_url(audio):
        yield Path(audio)
        return
    filesystem, inside = filesystem_of(audio)
    with tempfile.TemporaryDirectory(prefix="cushion-") as folder:
        path = Path(folder) / f"sound{PurePosixPath(inside).suffix}"
        with remote_errors(scrubbed(audio), UnreadableError):
            filesystem.get_file(inside, str(path))
        yield path

"""What the file of a sound or a result is known by, on this machine or behind a URL."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from audioflinger_hook.catalogue.addresses import filesystem_of, is_url, remote_errors, scrubbed
from audioflinger_hook.catalogue.timing import UnreadableError
from device.errors import UsageError

_STAMPS = (
    "ETag", "etag", "md5Hash", "content_md5", "generation", "version", "VersionId", "mtime",
    "LastModified", "last_modified", "modified", "updated", "created",
)  # fmt: skip
"""What storages call the etag of a file, or whatever else changes with its content."""


@dataclass(frozen=True)
class Stamp:
    """What a file is known by: bytes (None if unknown), and times or an etag, as text."""

    size: int | None
    stamp: str


def identity_of(audio: str) -> Stamp | None:
    """Return what a sound is known by, None if there is no such file."""
    if is_url(audio):
        filesystem, inside = filesystem_of(audio)
        with remote_errors(scrubbed(audio), UnreadableError):
            return remote_stamp(filesystem.info(inside))
    try:
        found = Path(audio).stat()
    except (OSError, ValueError):
        return None
    return Stamp(found.st_size, str(found.st_mtime_ns))


def local_stamp(path: Path) -> Stamp:
    """Return size, time and number of a file of this machine. OSError: it cannot be read."""
    found = path.stat()
    return Stamp(found.st_size, f"{found.st_mtime_ns}-{found.st_ino}")


def remote_stamp(info: dict[str, Any]) -> Stamp:
    """Return size and etag, or what is in place of an etag, from what fsspec says of a file."""
    found = [f"{name}={info[name]}" for name in _STAMPS if info.get(name)]
    size = info.get("size")
    return Stamp(None if size is None else int(size), found[0] if found else "")


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content. UsageError: it cannot be read."""
    try:
        return digest(path)
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror})") from error


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's content. OSError: it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

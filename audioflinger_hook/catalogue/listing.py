"""Search for sounds in local folders."""

import fnmatch
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from audioflinger_hook.sources.film import FILMS
from device.errors import UsageError

SOUNDS = FILMS | {
    *(".wav", ".wave", ".rf64", ".w64", ".flac", ".ogg", ".oga", ".opus", ".mp3", ".aif"),
    *(".aiff", ".au", ".caf", ".aac", ".ac3", ".eac3", ".dts", ".wma"),
}


def walk(folder: str, out: str) -> Iterator[str]:
    """Yield the paths of the files in a folder and its subfolders, in alphabetical order.

    Hidden files and folders, folders behind symbolic links, and the folder `out` are omitted.
    UsageError: a folder cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            names = sorted((entry.name, entry.is_dir()) for entry in entries)
    except OSError as error:
        raise UsageError(f"{folder} cannot be listed ({error.strerror})") from None
    for name, is_folder in names:
        path = f"{folder.rstrip('/')}/{name}"
        if name.startswith(".") or (is_folder and is_same(path, out)):
            continue
        if not is_folder:
            yield path
        elif not Path(path).is_symlink():  # a link may lead back to a parent folder
            yield from walk(path, out)


def is_same(path: str, other: str) -> bool:
    """Return whether two paths lead to the same file or folder, also through links."""
    if path == other:
        return True
    try:
        return Path(path).samefile(other)
    except (OSError, ValueError):  # a path is a URL or does not exist
        return False


def matches(path: list[str], pattern: list[str]) -> bool:
    """Return whether the parts of a path match those of a glob; `**` matches any folders."""
    if not pattern:
        return not path
    first, *rest = pattern
    if first == "**":
        return any(matches(path[n:], rest) for n in range(len(path) + 1))
    return bool(path) and fnmatch.fnmatchcase(path[0], first) and matches(path[1:], rest)


def is_sound(path: str) -> bool:
    """Return whether a file name has the suffix of a sound or film."""
    return PurePosixPath(path).suffix.lower() in SOUNDS

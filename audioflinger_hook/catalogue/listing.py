"""Search for sounds in local folders."""

import fnmatch
import os
from collections.abc import Iterator
from pathlib import Path

from audioflinger_hook.sources.film import FILMS
from device.errors import UsageError

SOUNDS = FILMS | {
    *(".wav", ".wave", ".rf64", ".w64", ".flac", ".ogg", ".oga", ".opus", ".mp3", ".aif"),
    *(".aiff", ".au", ".caf", ".aac", ".ac3", ".eac3", ".dts", ".wma"),
}


def walk(folder: str, out: str) -> Iterator[str]:
    """Yield the paths of the files in a folder and its subfolders, in alphabetical order.

    Hidden files and folders, folders behind symbolic links, and the folder `out` are omitted. Of a
    subfolder that cannot be read, its path is yielded, followed by a slash.
    UsageError: `folder` cannot be read.
    """
    waiting = [(folder.rstrip("/"), True)]  # in reverse order
    while waiting:
        path, is_folder = waiting.pop()
        if not is_folder:
            yield path
            continue
        try:
            with os.scandir(path or "/") as entries:
                named = [one for one in entries if not one.name.startswith(".")]
                found = [
                    (f"{path}/{one.name}", one.is_dir(follow_symlinks=False))
                    for one in named
                    if not (one.is_symlink() and os.path.isdir(one.path))  # noqa: PTH112
                ]
        except OSError as error:
            if path == folder.rstrip("/"):
                said = f"{folder} cannot be listed ({error.strerror}); allow it or name another"
                raise UsageError(said) from None
            yield f"{path}/"
            continue
        found = [(one, deep) for one, deep in found if not (deep and is_same(one, out))]
        waiting += sorted(found, reverse=True)


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
    return f".{path.rpartition('.')[2].lower()}" in SOUNDS

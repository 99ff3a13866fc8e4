"""Take real sounds out of Debian packages: unpack_sounds.py LIST TARGET FOLDER_OF_PACKAGES.

Writes TARGET/CLASS/PACKAGE-NAME for every file that the list (real_sounds.txt) chooses. Only the
standard library is used, so that any Python 3 runs it.
"""

from __future__ import annotations

import hashlib
import io
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

ARCHIVES = (".pk3", ".wz")
SOUNDS = (".wav", ".ogg", ".oga", ".flac")


@dataclass(frozen=True)
class Choice:
    """One line of the list: class, package, most files, and patterns of their paths."""

    kind: str
    package: str
    most: int
    patterns: tuple[str, ...]

    def chosen(self, paths: Iterator[str]) -> list[str]:
        """Return at most `most` of the paths that match, in the order of their names' hashes."""
        fit = {path for path in paths if any(fnmatchcase(path, each) for each in self.patterns)}
        return sorted(fit, key=name_hash)[: self.most]


def choices(text: str) -> list[Choice]:
    """Return the lines of a list, comments left out."""
    found = []
    for line in text.splitlines():
        kind, *rest = line.split() or ["#"]
        if not kind.startswith("#"):
            package, most, *patterns = rest
            found.append(Choice(kind, package, int(most), tuple(patterns)))
    return found


def name_hash(path: str) -> str:
    """Return what orders files and halves them, the same everywhere: a hash of the file's name."""
    return hashlib.sha256(path.rpartition("/")[2].encode()).hexdigest()


def sounds_in(package: Path) -> dict[str, bytes]:
    """Return the sound files of a Debian package by path, those in archives as ARCHIVE:path."""
    files = {}
    unpacked = subprocess.run(
        ["dpkg-deb", "--fsys-tarfile", str(package)], check=True, stdout=subprocess.PIPE
    ).stdout
    with tarfile.open(fileobj=io.BytesIO(unpacked)) as tar:
        for member in tar:
            content = tar.extractfile(member) if member.isfile() else None
            if content is None:
                continue
            if member.name.endswith(SOUNDS):
                files[member.name] = content.read()
            elif member.name.endswith(ARCHIVES):
                with zipfile.ZipFile(io.BytesIO(content.read())) as archive:
                    home = member.name.rpartition("/")[2]
                    inside = [name for name in archive.namelist() if name.endswith(SOUNDS)]
                    files |= {f"{home}:{name}": archive.read(name) for name in inside}
    return files


def main(listed: Path, target: Path, packages: Path) -> None:
    """Write every chosen file; a package that is not there gives none."""
    lines = choices(listed.read_text("utf-8"))
    for package in dict.fromkeys(line.package for line in lines):
        for path in packages.glob(f"{package}_*.deb"):
            files = sounds_in(path)
            for line in lines:
                if line.package != package:
                    continue
                folder = target / line.kind
                folder.mkdir(parents=True, exist_ok=True)
                for name in line.chosen(iter(files)):
                    (folder / f"{package}-{name.rpartition('/')[2]}").write_bytes(files[name])


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:4]))

"""Extracts sounds from Debian packages.

Usage: unpack_sounds.py LIST TARGET FOLDER_OF_PACKAGES. The program writes TARGET/CLASS/PACKAGE-NAME
    for each file that LIST (real_sounds.txt) selects. It uses only the standard library.
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
    """One line of the list, which selects files of a package.

    kind: class of the sounds.
    most: upper limit of the number of files.
    patterns: patterns of paths, as in a shell.
    """

    kind: str
    package: str
    most: int
    patterns: tuple[str, ...]

    def chosen(self, paths: Iterator[str]) -> list[str]:
        """Return up to `most` paths that match a pattern, chosen by hashes of their file names."""
        fit = {path for path in paths if any(fnmatchcase(path, each) for each in self.patterns)}
        return sorted(fit, key=name_hash)[: self.most]


def choices(text: str) -> list[Choice]:
    """Return the entries of a list, without comments."""
    found = []
    for line in text.splitlines():
        kind, *rest = line.split() or ["#"]
        if not kind.startswith("#"):
            package, most, *patterns = rest
            found.append(Choice(kind, package, int(most), tuple(patterns)))
    return found


def name_hash(path: str) -> str:
    """Return a hash of the file name, by which files are chosen and divided into halves."""
    return hashlib.sha256(path.rpartition("/")[2].encode()).hexdigest()


def sounds_in(package: Path) -> dict[str, bytes]:
    """Return the sound files of a Debian package by path; files in archives by ARCHIVE:PATH."""
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
    """Write all selected files. Missing packages are skipped."""
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

"""Reads manifests, which list the sounds of a catalogue: JSON lines, CSV, folders and globs."""

import csv
import glob
import gzip
import io
import json
import os
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from itertools import takewhile
from pathlib import Path
from struct import Struct
from typing import IO, Any

import numpy as np

from audioflinger_hook.catalogue import listing
from audioflinger_hook.catalogue.addresses import filesystem_of, is_url, parse_address, scrubbed
from audioflinger_hook.catalogue.item import ALIASES, Item, cell_value, default_id, shown, values_of
from device.errors import UsageError
from device.values import counted

SHOWN_MAX = 100  # largest number of listed mistakes; all mistakes are counted
LINE_MAX = 1 << 20
PARTITIONS = 64  # to find duplicates, ids are split by hash into this number of groups
KEPT_ITEMS = 10_000  # about 5 MB
SPOOLED_BYTES = 1 << 16  # memory of each group; larger groups go to temporary files
_ENTRY = Struct("<QQ?")


@dataclass
class Mistakes:
    """Mistakes in a manifest: messages about the first 100, and the number of all."""

    shown: list[str] = field(default_factory=list)
    count: int = 0

    def add(self, where: str, text: str) -> None:
        """Add a mistake. where: file and line. text: message."""
        self.count += 1
        if len(self.shown) < SHOWN_MAX:
            self.shown.append(f"{where}: {text}")


class Manifest:
    """The items of a manifest, in order. A manifest of over `KEPT_ITEMS` is read at each `items`.

    address: path or URL of JSON lines or CSV (.csv), plain or .gz, of a folder or sound; or a glob.
    out: folder of the results; sounds inside this folder are not items.
    UsageError: the manifest is missing or unreadable, or its address has credentials or is `out`.
    """

    def __init__(self, address: str, out: str) -> None:
        self.address = parse_address(address, "MANIFEST")
        self._name = scrubbed(self.address)
        self._folder = self.address.rpartition("/")[0]
        self.out = out
        self._true_out = out if is_url(out) else os.path.realpath(out)
        self._remote = filesystem_of(self.address) if is_url(self.address) else None
        self.is_listing = False
        self._root = ""
        self._shared: set[int] = set()  # hashes of the default ids that several items would have
        self._is_default = False  # whether the latest item has a default id without suffix
        self._kept: list[Item] | None = None  # by `check`, if they are few
        self._sources = self._kind()
        if listing.is_same(self.address, out):
            raise UsageError(f"--out={scrubbed(out)} is the folder of the sounds; name another")

    def check(self) -> tuple[int, Mistakes]:
        """Return the number of valid items, and mistakes. UsageError: unreadable, or no items.

        If several items would get the same default id, these ids are given their suffixes.
        """
        while True:
            known = len(self._shared)
            found = self._checked()
            if len(self._shared) == known:
                return found

    def _checked(self) -> tuple[int, Mistakes]:
        mistakes, count, kept = Mistakes(), 0, list[Item]()
        with ExitStack() as stack:
            parts = [
                stack.enter_context(tempfile.SpooledTemporaryFile(SPOOLED_BYTES))
                for _ in range(PARTITIONS)
            ]
            for count, item in enumerate(self.items(mistakes), 1):
                if count <= KEPT_ITEMS:
                    kept.append(item)
                name = _hash(item.id)
                parts[name % PARTITIONS].write(_ENTRY.pack(name, item.line, self._is_default))
            for part in parts:
                self._find_duplicates(part, mistakes)
        if not count and not mistakes.count:
            raise UsageError(f"{scrubbed(self.address)} has no items; give a manifest of sounds")
        self._kept = kept if count == len(kept) else None
        return count, mistakes

    def items(self, mistakes: Mistakes | None = None) -> Iterator[Item]:
        """Yield the valid items; add the mistakes of invalid items to `mistakes`."""
        if mistakes is None and self._kept is not None:
            yield from self._kept
            return
        mistakes = mistakes if mistakes is not None else Mistakes()
        for line, row in self._rows(mistakes):
            item, wrong = self._item(line, row)
            for text in wrong:
                mistakes.add(f"{self._name}:{line}", text)
            if item:
                yield item

    def _item(self, line: int, row: dict[str, Any]) -> tuple[Item | None, list[str]]:
        values, wrong = values_of(row)
        if wrong:
            return None, wrong
        audio, named = values.get("audio"), "id" in values
        self._is_default = not named
        if not named:
            source = str(audio), values.get("start_s"), self._root
            values["id"] = default_id(*source)
            if self._shared and _hash(values["id"]) in self._shared:
                values["id"], self._is_default = default_id(*source, whole=True), False
        values["line"] = line
        if audio and isinstance(audio, str):
            # Relative paths start at the manifest's folder, which may be a URL.
            inside = not (is_url(audio) or audio.startswith("/"))
            whole = f"{self._folder}/{audio}" if inside else audio
            values["audio"] = whole if is_url(whole) else os.path.normpath(whole)
        try:
            item = Item(**values)
        except (UsageError, TypeError):
            refusals = Item.refusals(values)
            if not named and "audio" in refusals:
                refusals.pop("id", None)  # The default id comes from the refused audio.
            given = {name: f"={shown(values[name])}" if name in values else "" for name in refusals}
            return None, [f"{name}{given[name]} {refusal}" for name, refusal in refusals.items()]
        if self._is_in_out(item.audio):
            return None, [f"audio={shown(item.audio)} is in the output folder; name another"]
        return item, []

    def _is_in_out(self, audio: str) -> bool:
        if f"{audio}/".startswith(f"{self.out}/"):
            return True
        if is_url(audio) or is_url(self.out):
            return False
        folder = _true_folder(audio.rpartition("/")[0])
        return f"{folder}/".startswith(f"{self._true_out.rstrip('/')}/")

    def _kind(self) -> str:
        """Return the kind of manifest: "folder", "glob", "one" (sound), "csv" or "lines" (JSON)."""
        path = self.address
        unpacked = path.removesuffix(".gz")
        if self._remote:
            filesystem, inside = self._remote
            try:
                is_folder = filesystem.isdir(inside)
                there = is_folder or filesystem.exists(inside)
            except Exception as error:
                said = f"{type(error).__name__}: {scrubbed(str(error))}"
                raise UsageError(f"{self._name} cannot be read ({said})") from None
        else:
            is_folder, there = Path(path).is_dir(), Path(path).exists()
        if is_folder:
            self._root, self.is_listing = f"{path}/", True
            return "folder"
        if not there and glob.has_magic(path):
            fixed = takewhile(lambda part: not glob.has_magic(part), path.split("/"))
            self._root, self.is_listing = f"{'/'.join(fixed)}/", True
            return "glob"
        if not there:
            raise UsageError(f"{self._name} does not exist; give a manifest, a folder or a glob")
        if listing.is_sound(unpacked):
            self._root, self.is_listing = f"{path.rpartition('/')[0]}/", True
            return "one"
        return "csv" if Path(unpacked).suffix.lower() == ".csv" else "lines"

    def _rows(self, mistakes: Mistakes) -> Iterator[tuple[int, dict[str, Any]]]:
        if self.is_listing:
            yield from ((number, {"audio": audio}) for number, audio in enumerate(self._found(), 1))
            return
        try:
            with ExitStack() as stack:
                if self._remote:
                    filesystem, inside = self._remote
                    # The `readline` of fsspec's file objects ignores its length limit.
                    file: Any = io.BufferedReader(stack.enter_context(filesystem.open(inside)))
                else:
                    file = stack.enter_context(Path(self.address).open("rb"))
                if self.address.endswith(".gz"):
                    file = stack.enter_context(gzip.GzipFile(fileobj=file))
                rows = self._csv if self._sources == "csv" else self._lines
                yield from rows(file, mistakes)
        except (OSError, EOFError, UnicodeDecodeError, zlib.error) as error:
            said = scrubbed(getattr(error, "strerror", None) or str(error))
            raise UsageError(f"{self._name} cannot be read ({said})") from None

    def _lines(self, file: IO[bytes], mistakes: Mistakes) -> Iterator[tuple[int, dict[str, Any]]]:
        for line, text in enumerate(iter(lambda: file.readline(LINE_MAX), b""), 1):
            where = f"{self._name}:{line}"
            if len(text) == LINE_MAX and not text.endswith(b"\n"):
                mistakes.add(where, f"is longer than {LINE_MAX} bytes; give one object a line")
                return
            if not text.strip():
                continue
            try:
                row = json.loads(text.decode("utf-8-sig" if line == 1 else "utf-8"))
            except UnicodeDecodeError:
                mistakes.add(where, "is not UTF-8; save the manifest as UTF-8")
            except (ValueError, RecursionError) as error:
                said = getattr(error, "msg", "is nested too deeply")
                mistakes.add(where, f"is not JSON ({said}); give one object a line")
            else:
                if isinstance(row, dict):
                    yield line, row
                    continue
                mistakes.add(where, 'is not an object; allowed: {"audio": "PATH or URL", ...}')

    def _csv(self, file: IO[bytes], mistakes: Mistakes) -> Iterator[tuple[int, dict[str, Any]]]:
        with io.TextIOWrapper(file, "utf-8-sig", errors="surrogateescape", newline="") as text:
            reader, header = csv.reader(text, strict=True), list[str]()
            while True:
                where = f"{self._name}:{reader.line_num + 1}"
                try:
                    row = next(reader, None)
                except csv.Error as error:
                    mistakes.add(where, f"is not CSV ({error})")
                    return
                if row is None:
                    return
                if not header:
                    header = [name.strip() for name in row]
                    if "audio" not in (ALIASES.get(name, name) for name in header):
                        mistakes.add(where, f"the header has no column audio: {shown(header)}")
                        return
                elif row and len(row) != len(header):
                    has, expected = (counted(len(one), "columns") for one in (row, header))
                    mistakes.add(where, f"has {has}; the header has {expected}")
                elif row:
                    cells = zip(header, row, strict=True)
                    values = {name: cell_value(name, cell) for name, cell in cells if cell}
                    yield reader.line_num, values

    def _found(self) -> Iterator[str]:
        if self._sources == "one":
            yield self.address
        elif self._remote:
            filesystem, inside = self._remote
            is_glob = self._sources == "glob"
            for name in sorted(filesystem.glob(inside) if is_glob else filesystem.find(inside)):
                audio = str(filesystem.unstrip_protocol(name))
                if (is_glob or listing.is_sound(name)) and not audio.startswith(f"{self.out}/"):
                    yield audio
        elif self._sources == "glob":
            paths = listing.walk(self._root.rstrip("/"), self.out)
            pattern = self.address.split("/")
            for path in paths:
                parts = path.removesuffix("/").split("/")
                # a folder that cannot be read counts if the glob may match files in it
                most = [pattern[:count] for count in range(len(pattern))]
                wanted = most if path.endswith("/") else [pattern]
                if any(listing.matches(parts, one) for one in wanted):
                    yield path
        else:
            for path in listing.walk(self.address, self.out):
                if path.endswith("/") or listing.is_sound(path):
                    yield path

    def _find_duplicates(self, part: IO[bytes], mistakes: Mistakes) -> None:
        part.seek(0)
        entries = np.frombuffer(part.read(), [("name", "<u8"), ("line", "<u8"), ("grows", "?")])
        entries = entries[np.lexsort((entries["line"], entries["name"]))]
        is_again = entries["name"][1:] == entries["name"][:-1]
        again = np.flatnonzero(is_again)
        grows = entries["grows"][:-1] | entries["grows"][1:]
        self._shared.update(entries["name"][1:][is_again & grows].tolist())
        for index in again[:SHOWN_MAX]:
            first, second = entries["line"][index], entries["line"][index + 1]
            what = "item" if self.is_listing else "line"
            advice = "list them in a manifest with an id each" if self.is_listing else "give ids"
            mistakes.add(f"{self._name}:{second}", f"has the same id as {what} {first}; {advice}")
        mistakes.count += max(0, len(again) - SHOWN_MAX)


def _hash(name: str) -> int:
    return int.from_bytes(blake2b(name.encode(), digest_size=8).digest())


_true_folder: Callable[[str], str] = lru_cache(maxsize=1024)(os.path.realpath)

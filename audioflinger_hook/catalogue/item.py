"""One item of a catalogue, and the columns that describe it in a manifest."""

import re
from contextlib import suppress
from dataclasses import dataclass, fields
from difflib import get_close_matches
from functools import lru_cache
from hashlib import blake2b
from typing import Annotated, Any
from urllib.parse import urlsplit

from audioflinger_hook.catalogue import addresses
from audioflinger_hook.catalogue.addresses import is_url, scrubbed
from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.exports.options import FORMATS
from device.values import Choice, Described, Number, Refusal, Text

LONGEST_S = 1e7
RESERVED = re.compile(r"catalogue|failed(-\d+-of-\d+)?")  # names of files that a run writes itself
NAME_BYTES_MAX = 200
OWN_FILES = re.compile(rf"({RESERVED.pattern})\.jsonl?")
WRITTEN = (".json", *(one.suffixes[0] for one in FORMATS.values()))  # suffixes of files of a run
USABLE_BYTES = 160  # of a part of a path in a default id; a hash and the start may follow

ALIASES = {  # maps column names of NeMo and lhotse to the names used here
    "audio_filepath": "audio",  # NeMo
    "offset": "start_s",
    "start": "start_s",  # lhotse
    "duration": "duration_s",
    "channel": "channels",
}

# A misspelled name of one of these columns is reported: the typo would silently change results.
_SIMILAR = ("audio", "start_s", "duration_s", "channels", "profile", "language", "audio_filepath")


@dataclass(frozen=True)
class _Audio(Text):
    grammar: str = "a path, or a URL of a storage that fsspec knows"

    def refuse(self, value: object) -> Refusal | None:
        if (refusal := super().refuse(value)) or not isinstance(value, str):
            return refusal
        if "\0" in value:
            return Refusal("holds a null byte", self.allowed)
        if addresses.credentials_in(value):
            wrong, _, allowed = addresses.NO_CREDENTIALS.partition("; allowed: ")
            return Refusal(wrong, allowed)
        if is_url(value) and not addresses.known_scheme(value):
            return Refusal("has an unknown scheme", self.allowed)
        return None


@dataclass(frozen=True)
class _Name(Text):
    """Name of a result in the output folder: a relative path without "." and ".."."""

    grammar: str = "a relative path without . and .., such as album/song"

    def refuse(self, value: object) -> Refusal | None:
        if not isinstance(value, str) or not value:
            return Refusal("is not a name", self.allowed)
        parts = value.split("/")
        if any(part in ("", ".", "..") for part in parts) or not value.isprintable():
            return Refusal("is not a name of a result", self.allowed)
        if max(len(part.encode()) for part in parts) > NAME_BYTES_MAX:
            return Refusal("is too long", f"up to {NAME_BYTES_MAX} bytes between two slashes")
        if RESERVED.fullmatch(value) or OWN_FILES.fullmatch(parts[0]):
            return Refusal("is the name of a file of the run itself", "another name")
        return None


@dataclass(frozen=True)
class _Channels(Text):
    grammar: str = "mono, each, or channel numbers counted from 0"

    def refuse(self, value: object) -> Refusal | None:
        numbers = value if isinstance(value, tuple) else ()
        if numbers and all(type(one) is int and 0 <= one < 64 for one in numbers):
            return None
        known = value in ("mono", "each")
        return None if known else Refusal("is not a choice of channels", self.allowed)

    def json_schema(self) -> dict[str, Any]:
        numbers = {"type": "array", "items": {"type": "integer", "minimum": 0}}
        return {"anyOf": [{"enum": ["mono", "each"]}, {"type": "integer"}, numbers]}


@dataclass(frozen=True)
class Item(Described):
    """One sound of a catalogue. line: its line in the manifest or number in a folder, from 1."""

    audio: Annotated[str, _Audio("the sound: path or URL")]
    id: Annotated[str, _Name("name of the result")]
    line: int
    start_s: Annotated[float, Number("start of the part to render", 0.0, LONGEST_S, "s")] = 0.0
    duration_s: Annotated[
        float | None, Number("longest duration; default: to the end", 1e-3, LONGEST_S, "s")
    ] = None
    channels: Annotated[
        str | tuple[int, ...] | None, _Channels("like --channels, or numbers of channels")
    ] = None
    profile: Annotated[str | None, Choice("like --profile", tuple(PROFILES))] = None
    track: Annotated[int | None, Number("sound track of a film, from 1", 1, 999, whole=True)] = None
    language: Annotated[str | None, Text("language of a film's sound track")] = None

    @property
    def picked(self) -> tuple[int, ...]:
        """Numbers of the channels to use, from 0; empty for all channels."""
        return self.channels if isinstance(self.channels, tuple) else ()

    def row(self) -> dict[str, Any]:
        """Return this item as the keys and values of a manifest's line."""
        row = {name: getattr(self, name) for name in COLUMNS}
        return {name: value for name, value in row.items() if value not in (None, 0.0)}


COLUMNS = tuple(field.name for field in fields(Item) if field.name != "line")


def default_id(audio: str, start_s: object, root: str = "", *, whole: bool = False) -> str:
    """Return the sound's path without `root` and suffix; the start, if above 0, is appended.

    Parts that cannot be names of results are replaced. whole: keep the suffix.
    """
    path = audio.removeprefix(root) if root else audio
    path = urlsplit(path).path if is_url(path) else path
    *folders, last = [part for part in path.split("/") if part not in ("", ".", "..")] or [""]
    stem, _, suffix = last.rpartition(".")
    if stem and suffix and not whole:
        last = stem
    name = "/".join([*(_usable(part, part.endswith(WRITTEN)) for part in folders), _usable(last)])
    if RESERVED.fullmatch(name):
        return default_id(audio, start_s, root, whole=True)
    if isinstance(start_s, (int, float)) and start_s > 0.0:
        name += f"-{start_s:.6f}".rstrip("0").rstrip(".") + "s"
    return name


def _usable(part: str, is_taken: bool = False) -> str:
    """Return a part of a path; if it cannot be printed or used, with a hash of it."""
    if part.isprintable() and len(part.encode()) <= USABLE_BYTES and not is_taken:
        return part
    content = part.encode("utf-8", "surrogatepass")
    start = "".join(one if one.isprintable() else "_" for one in part).encode()[:USABLE_BYTES]
    return f"{start.decode(errors='ignore')}-{blake2b(content, digest_size=4).hexdigest()}"


def shown(value: object) -> str:
    """Return a manifest's value as text for a message, shortened and without credentials."""
    text = scrubbed(str(value))
    return repr(text if len(text) <= 80 else f"{text[:77]}...")


def values_of(row: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return a row's values, keyed by the names of fields, and messages about wrong columns."""
    values: dict[str, Any] = {}
    mistakes = []
    for name, value in _from_lhotse(row).items():
        if (ours := ALIASES.get(name, name)) in COLUMNS:
            if ours not in values:
                values[ours] = value
            elif values[ours] != value:
                both = f"{shown(values[ours])} and {shown(value)}"
                mistakes.append(f"{ours} is given twice, as {both}; leave one out")
        elif guess := _meant(name):
            mistakes.append(f"{shown(name)} is not known; did you mean {guess}?")
    if mistakes:
        return values, mistakes
    # Convert the values to the types of the fields where possible.
    found = {name: value for name, value in values.items() if value is not None}
    if type(channels := found.get("channels")) is int:
        found["channels"] = (channels,)
    elif isinstance(channels, list):
        found["channels"] = tuple(channels)
    seconds = [name for name in ("start_s", "duration_s") if type(found.get(name)) is int]
    return found | {name: float(found[name]) for name in seconds}, mistakes


def cell_value(name: str, cell: str) -> Any:
    """Return the value of a CSV cell: text, a number, or a list of channel numbers."""
    ours = ALIASES.get(name, name)
    with suppress(ValueError):
        if ours == "track":
            return int(cell)
        if ours in ("start_s", "duration_s"):
            return float(cell)
        if ours == "channels" and cell not in ("mono", "each"):
            return [int(one) for one in cell.split()]
    return cell


@lru_cache(maxsize=1024)
def _meant(name: str) -> str:
    """Return the column name that was probably meant by `name`; "" if there is none."""
    similar = get_close_matches(name.lower().replace("-", "_"), _SIMILAR, n=1, cutoff=0.8)
    # lhotse's `channel_ids` is not a misspelling of `channels`.
    return next((known for known in similar if abs(len(name) - len(known)) <= 1), "")


def _from_lhotse(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row, with the key "audio" if it is a recording or cut of the library lhotse."""
    match row.get("recording", row):
        case {"sources": [{"type": "file" | "url", **source}]}:
            return {**row, "audio": source.get("source")}
    return row

"""The files of a capture, their names, and every line of its index. Version 1.

A capture is a folder:

    index.jsonl       what was delivered, one line a buffer
    tap-0001.wav      the samples of stream `tap`, first segment
    tap-0002.wav      the next: the rate or the number of channels changed
    effect-0001.wav   stream `effect`: the vibration before the delay line (recordings of a run)
    device-0001.wav   stream `device`: the frames sent to the device (recordings of a run)

Other files in the folder are left alone.

**Segments** are WAV files of 32-bit float, little-endian. Samples are stored as delivered, also
NaN, infinity and values beyond +-1. A segment holds one format. The samples begin at byte 94,
behind a header that is RIFF or, above 4 GB, RF64. The header's sizes are updated after every
buffer, so a player reads a truncated capture like any other file, at most one buffer short.

**The index** is text, one JSON object a line, only ever appended to. The last member of every line
is `crc`: the CRC-32 (zlib), as 8 hexadecimal digits, of all bytes of the line before `,"crc"`.
`kind` says what the line is:

    capture   the first line: format, version, streams, facts (what the maker had to say)
    buffer    one buffer: stream; buffer (its number in the stream, from 0); segment (from 1);
              first (its first frame in the segment); frames (may be 0); samplerate (Hz); channels;
              time_s (seconds of the recorder's monotonic clock); discontinuity (true: frames are
              missing before it); samples_crc (CRC-32 of its samples as they lie in the segment)
    dropped   buffers of a stream that came here and could not be kept: stream, buffers, frames
    end       the capture was closed: buffers (stream -> how many it holds)

A reader of version 1 passes over other kinds, and over other members.

**Order.** The samples of a buffer are written before its line, so a whole line means a whole
buffer. Each line holds all that is needed to find its samples, so a lost line harms no other.
`samples_crc` detects samples that a power failure lost or another program changed.

Pure functions; any thread may call them.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import zlib
from collections.abc import Generator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, get_origin, get_type_hints

from device.errors import InternalError, UsageError

FORMAT = "haptic-cushion capture"
VERSION = 1
INDEX_NAME = "index.jsonl"
STREAMS = ("tap", "effect", "device")
SAMPLES_OFFSET = 94  # bytes of the header from `device.wav_output.wav_header` without a comment
LINE_BYTES_MAX = 65_536  # limits the memory that a damaged index can take
FIRST_BYTES = f'{{"kind":"capture","format":"{FORMAT}"'.encode()  # of every index

Facts = Mapping[str, str | int | float | bool]
"""Settings that the recorder stores, by name; a name ends in its unit."""

_SEGMENT_NAME = re.compile(rf"({'|'.join(STREAMS)})-(\d{{4,}})\.wav")
_CRC = re.compile(rb'(\{.*),"crc":"([0-9a-f]{8})"\}\n?', re.DOTALL)


@dataclass(frozen=True)
class Record:
    """A valid line of the index; also one of a kind that this program does not know."""

    KIND: ClassVar[str] = ""

    def line(self) -> bytes:
        """Return the line, with its line break. InternalError: no line can hold the fields."""
        members = {"kind": self.KIND, **asdict(self)}
        try:
            text = json.dumps(members, separators=(",", ":"), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InternalError(
                f"a {self.KIND} line of a capture cannot hold {members}: {error}"
            ) from error
        body = text[:-1].encode()
        line = b'%s,"crc":"%08x"}\n' % (body, zlib.crc32(body))
        if len(line) > LINE_BYTES_MAX:
            raise InternalError(
                f"a {self.KIND} line of a capture has {len(line)} bytes; allowed: {LINE_BYTES_MAX}"
            )
        return line


@dataclass(frozen=True)
class Header(Record):
    """The first line: the streams and the recorder's settings."""

    KIND: ClassVar[str] = "capture"
    format: str = FORMAT
    version: int = VERSION
    streams: list[str] = field(default_factory=list)
    facts: dict[str, str | int | float | bool] = field(default_factory=dict)


@dataclass(frozen=True)
class BufferRecord(Record):
    """One buffer: where its samples are, and how and when it was delivered."""

    KIND: ClassVar[str] = "buffer"
    stream: str
    buffer: int
    segment: int
    first: int
    frames: int
    samplerate: int
    channels: int
    time_s: float
    discontinuity: bool
    samples_crc: str


@dataclass(frozen=True)
class DroppedRecord(Record):
    """Lost buffers before the next buffer of the stream."""

    KIND: ClassVar[str] = "dropped"
    stream: str
    buffers: int
    frames: int


@dataclass(frozen=True)
class EndRecord(Record):
    """The capture was closed; how many buffers each stream holds."""

    KIND: ClassVar[str] = "end"
    buffers: dict[str, int]


KINDS = (Header, BufferRecord, DroppedRecord, EndRecord)
TYPES: dict[type[Record], dict[str, Any]] = {
    kind: {one.name: get_origin(hints[one.name]) or hints[one.name] for one in fields(kind)}
    for kind in (Record, *KINDS)
    for hints in [get_type_hints(kind)]
}
"""The type that JSON gives to each field of a kind of record."""


def _is_valid(record: Record) -> bool:
    """Return whether every field has a value that a recorder writes."""
    match record:
        case Header():
            plain = all(isinstance(fact, str | int | float) for fact in record.facts.values())
            return plain and all(isinstance(name, str) for name in record.streams)
        case BufferRecord(buffer=buffer, first=first, frames=frames):
            least = min(record.segment, record.channels, record.samplerate)
            return min(buffer, first, frames) >= 0 and least >= 1 and math.isfinite(record.time_s)
        case DroppedRecord():
            return min(record.buffers, record.frames) >= 0
        case EndRecord():
            return all(type(count) is int and count >= 0 for count in record.buffers.values())
    return True


def segment_name(stream: str, segment: int) -> str:
    """Return the file name of a stream's segment; segments count from 1."""
    return f"{stream}-{segment:04d}.wav"


def segment_paths(folder: Path, stream: str) -> dict[int, Path]:
    """Return the segments of a stream in the folder, by number, ascending."""
    numbers = []
    for name in (path.name for path in folder.iterdir()):
        found = _SEGMENT_NAME.fullmatch(name)
        if found and found[1] == stream and name == segment_name(stream, int(found[2])):
            numbers.append(int(found[2]))
    return {number: folder / segment_name(stream, number) for number in sorted(numbers)}


def parse_line(line: bytes) -> Record | None:
    """Return the record of a line, or None if it is torn or damaged.

    A whole line without its line break is valid.
    """
    found = _CRC.fullmatch(line)
    if not found or zlib.crc32(found[1]) != int(found[2], 16):
        return None
    try:
        members = json.loads(found[1] + b"}")
        if type(members["kind"]) is not str:
            return None
        kind = next((one for one in KINDS if members["kind"] == one.KIND), Record)
        given = {name: members[name] for name in TYPES[kind]}
        fitting = all(type(given[name]) is one for name, one in TYPES[kind].items())
        record = kind(**given) if fitting else None
        return record if record and _is_valid(record) else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def records(path: Path) -> Generator[Record | None, None, None]:
    """Yield the record of every line, or None for a torn or damaged one.

    Memory use is constant. Raises UsageError if the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            while line := file.readline(LINE_BYTES_MAX):
                whole = line.endswith(b"\n")
                yield parse_line(line)
                while not whole and (line := file.readline(LINE_BYTES_MAX)):
                    whole = line.endswith(b"\n")  # the rest of an overlong line
    except OSError as error:
        raise UsageError(
            f"{path} cannot be read ({error.strerror}); check its permissions"
        ) from None


def first_record(path: Path) -> Record | None:
    """Return the first valid line: the header, or if it is damaged another line; or None."""
    with contextlib.closing(records(path)) as found:
        return next((record for record in found if record is not None), None)


def begins_like_an_index(path: Path) -> bool:
    """Return whether the file holds only the beginning of a header."""
    with path.open("rb") as file:
        start = file.read(len(FIRST_BYTES))
    return FIRST_BYTES.startswith(start)

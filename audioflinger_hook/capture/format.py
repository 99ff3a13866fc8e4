"""File format of a capture, version 1.

A capture is a folder:

    index.jsonl       one line for each buffer
    tap-0001.wav      samples of stream `tap`, first segment
    tap-0002.wav      next segment, after a change of sample rate or number of channels
    effect-0001.wav   stream `effect`: the vibration before the delay line (only from `cushion run`)
    device-0001.wav   stream `device`: the frames sent to the device (only from `cushion run`)

**Segments** are WAV files of 32-bit float, little-endian. Samples are stored as delivered,
including NaN, infinity and values beyond ±1. The samples begin at byte 94, after a header of type
RIFF or, above 4 GB, RF64. The writer updates the sizes in the header after every buffer. If the
writer is killed, the header therefore omits at most one buffer.

**The index** is text with one JSON object per line. Lines are only appended. The last member of
every line is `crc`: the CRC-32 (zlib), as 8 hexadecimal digits, of all bytes of the line before
`,"crc"`. The member `kind` states the meaning of the line. Its values, and the other members, are:

    capture   the first line: format, version, streams, facts (settings of the recording)
    buffer    one buffer: stream; buffer (its number in the stream, from 0); segment (from 1);
              first (its first frame in the segment, from 0); frames (count, may be 0); samplerate
              (Hz); channels (count); time_s (time of delivery in s, by a monotonic clock);
              discontinuity (true: frames are missing before this buffer); samples_crc (CRC-32 of
              the buffer's samples)
    dropped   buffers that were delivered but not stored: stream, buffers, frames (counts)
    end       the capture was closed: buffers (number of buffers in each stream)

Readers ignore other files, kinds and members. A buffer's samples are written before its line,
so the samples of every line exist even after the writer was killed. Each line alone locates its
samples, so a damaged line affects no other buffer. `samples_crc` detects samples that a power
failure lost or another program changed. Any thread may call the module's functions.
"""

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
SAMPLES_OFFSET = 94  # length in bytes of a header from `device.wav_output.wav_header`
LINE_BYTES_MAX = 65_536  # limits the memory that a damaged index needs
FIRST_BYTES = f'{{"kind":"capture","format":"{FORMAT}"'.encode()  # beginning of every index

Facts = Mapping[str, str | int | float | bool]  # settings of the recording, by name
_SEGMENT_NAME = re.compile(rf"({'|'.join(STREAMS)})-(\d{{4,}})\.wav")
_CRC = re.compile(rb'(\{.*),"crc":"([0-9a-f]{8})"\}\n?', re.DOTALL)


@dataclass(frozen=True)
class Record:
    """A valid line of the index. A line of an unknown kind becomes an object of this class."""

    KIND: ClassVar[str] = ""

    def line(self) -> bytes:
        """Return the line with its line break. InternalError: it is too long, or not valid JSON."""
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
    """The first line: the names of the streams, and the settings of the recording as `facts`."""

    KIND: ClassVar[str] = "capture"
    format: str = FORMAT
    version: int = VERSION
    streams: list[str] = field(default_factory=list)
    facts: dict[str, str | int | float | bool] = field(default_factory=dict)


@dataclass(frozen=True)
class BufferRecord(Record):
    """One buffer: the place of its samples, its format and its time of delivery."""

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
    """Numbers of buffers and frames that were dropped before the next buffer of the stream."""

    KIND: ClassVar[str] = "dropped"
    stream: str
    buffers: int
    frames: int


@dataclass(frozen=True)
class EndRecord(Record):
    """The last line of a closed capture. buffers: number of buffers in each stream."""

    KIND: ClassVar[str] = "end"
    buffers: dict[str, int]


KINDS = (Header, BufferRecord, DroppedRecord, EndRecord)
TYPES: dict[type[Record], dict[str, Any]] = {  # type of each field in parsed JSON
    kind: {one.name: get_origin(hints[one.name]) or hints[one.name] for one in fields(kind)}
    for kind in (Record, *KINDS)
    for hints in [get_type_hints(kind)]
}


def _is_valid(record: Record) -> bool:
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
    """Return the file name of a segment. segment: number in the stream, from 1."""
    return f"{stream}-{segment:04d}.wav"


def segment_paths(folder: Path, stream: str) -> dict[int, Path]:
    """Return the paths of a stream's segments, keyed by their numbers in ascending order."""
    numbers = []
    for name in (path.name for path in folder.iterdir()):
        found = _SEGMENT_NAME.fullmatch(name)
        if found and found[1] == stream and name == segment_name(stream, int(found[2])):
            numbers.append(int(found[2]))
    return {number: folder / segment_name(stream, number) for number in sorted(numbers)}


def parse_line(line: bytes) -> Record | None:
    """Parse a line, with or without its line break; return None if the line is damaged."""
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
    """Yield each line, parsed; None for a damaged line. UsageError: the file cannot be read."""
    try:
        with path.open("rb") as file:
            while line := file.readline(LINE_BYTES_MAX):
                whole = line.endswith(b"\n")
                yield parse_line(line)
                while not whole and (line := file.readline(LINE_BYTES_MAX)):
                    whole = line.endswith(b"\n")  # skips the rest of an overlong line
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); check permissions") from None


def first_record(path: Path) -> Record | None:
    """Return the first valid line, parsed, or None. In an intact index, it is the `Header`."""
    with contextlib.closing(records(path)) as found:
        return next((record for record in found if record is not None), None)


def begins_like_an_index(path: Path) -> bool:
    """Return whether the file begins like an index, or is cut off within this beginning."""
    with path.open("rb") as file:
        start = file.read(len(FIRST_BYTES))
    return FIRST_BYTES.startswith(start)

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
from dataclasses import asdict, dataclass, field
from pathlib import Path

from device.errors import InternalError, UsageError

FORMAT = "haptic-cushion capture"
VERSION = 1
INDEX_NAME = "index.jsonl"
STREAMS = ("tap", "effect", "device")
SAMPLES_OFFSET = 94
"""Length in bytes of the header from `device.wav_output.wav_header` without a comment."""

LINE_BYTES_MAX = 65_536
"""Longest line of an index; limits the memory that a damaged file can take."""

FIRST_BYTES = f'{{"kind":"capture","format":"{FORMAT}"'.encode()
"""Beginning of every index."""

Facts = Mapping[str, str | int | float | bool]
"""Settings that the recorder stores, by name; a name ends in its unit."""

_SEGMENT_NAME = re.compile(rf"({'|'.join(STREAMS)})-(\d{{4,}})\.wav")
_CRC = re.compile(rb'(\{.*),"crc":"([0-9a-f]{8})"\}\n?', re.DOTALL)


@dataclass(frozen=True, slots=True)
class Header:
    """The first line: the streams and the recorder's settings."""

    streams: tuple[str, ...]
    facts: Facts = field(default_factory=dict)
    format: str = FORMAT
    version: int = VERSION

    def line(self) -> bytes:
        """The line, with its line break."""
        fields = {"format": self.format, "version": self.version, "streams": list(self.streams)}
        return _line("capture", {**fields, "facts": dict(self.facts)})


@dataclass(frozen=True, slots=True)
class BufferRecord:
    """One buffer: where its samples are, and how and when it was delivered."""

    stream: str
    buffer: int
    segment: int
    first: int
    frames: int
    samplerate: int
    channels: int
    time_s: float
    discontinuity: bool
    samples_crc: int

    def line(self) -> bytes:
        """The line, with its line break."""
        return _line("buffer", {**asdict(self), "samples_crc": f"{self.samples_crc:08x}"})


@dataclass(frozen=True, slots=True)
class DroppedRecord:
    """Lost buffers before the next buffer of the stream."""

    stream: str
    buffers: int
    frames: int

    def line(self) -> bytes:
        """The line, with its line break."""
        return _line("dropped", asdict(self))


@dataclass(frozen=True, slots=True)
class EndRecord:
    """The capture was closed; how many buffers each stream holds."""

    buffers: Mapping[str, int]

    def line(self) -> bytes:
        """The line, with its line break."""
        return _line("end", {"buffers": dict(self.buffers)})


@dataclass(frozen=True, slots=True)
class OtherRecord:
    """A valid line of a kind that this program does not know."""

    kind: str


Record = Header | BufferRecord | DroppedRecord | EndRecord | OtherRecord


def segment_name(stream: str, segment: int) -> str:
    """The file name of a stream's segment; segments count from 1."""
    return f"{stream}-{segment:04d}.wav"


def segment_paths(folder: Path, stream: str) -> dict[int, Path]:
    """The segments of a stream in the folder, by number, ascending."""
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
        fields = json.loads(found[1] + b"}")
        return _record(fields)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _line(kind: str, fields: Mapping[str, object]) -> bytes:
    try:
        text = json.dumps({"kind": kind, **fields}, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InternalError(f"a {kind} line of a capture cannot hold {fields}: {error}") from error
    body = text[:-1].encode()
    line = b'%s,"crc":"%08x"}\n' % (body, zlib.crc32(body))
    if len(line) > LINE_BYTES_MAX:
        raise InternalError(
            f"a {kind} line of a capture has {len(line)} bytes; allowed: {LINE_BYTES_MAX}"
        )
    return line


def _record(fields: dict[str, object]) -> Record | None:
    kind = fields["kind"]
    if kind == "buffer":
        return _buffer_record(fields)
    if kind == "dropped":
        counts = _count(fields["buffers"]), _count(fields["frames"])
        return DroppedRecord(_text(fields["stream"]), *counts)
    if kind == "end":
        return EndRecord({_text(name): _count(n) for name, n in _members(fields["buffers"])})
    if kind == "capture":
        streams = fields["streams"]
        return Header(
            tuple(_text(name) for name in streams) if isinstance(streams, list) else (),
            {name: _fact(fact) for name, fact in _members(fields["facts"])},
            _text(fields["format"]),
            _count(fields["version"]),
        )
    return OtherRecord(_text(kind))


def _buffer_record(fields: Mapping[str, object]) -> BufferRecord:
    time_s, discontinuity = fields["time_s"], fields["discontinuity"]
    if not isinstance(time_s, float) or not math.isfinite(time_s):
        raise TypeError
    if not isinstance(discontinuity, bool):
        raise TypeError
    return BufferRecord(
        stream=_text(fields["stream"]),
        buffer=_count(fields["buffer"]),
        segment=_count(fields["segment"], 1),
        first=_count(fields["first"]),
        frames=_count(fields["frames"]),
        samplerate=_count(fields["samplerate"], 1),
        channels=_count(fields["channels"], 1),
        time_s=time_s,
        discontinuity=discontinuity,
        samples_crc=int(_text(fields["samples_crc"]), 16),
    )


def _count(found: object, least: int = 0) -> int:
    # bool is an int to isinstance
    if type(found) is not int or found < least:
        raise TypeError
    return found


def _text(found: object) -> str:
    if not isinstance(found, str):
        raise TypeError
    return found


def _fact(found: object) -> str | int | float | bool:
    if not isinstance(found, str | int | float | bool):
        raise TypeError
    return found


def _members(found: object) -> list[tuple[str, object]]:
    if not isinstance(found, dict):
        raise TypeError
    return list(found.items())


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
    """The first valid line: the header, or if it is damaged another line; or None."""
    with contextlib.closing(records(path)) as found:
        return next((record for record in found if record is not None), None)


def begins_like_an_index(path: Path) -> bool:
    """Return whether the file holds only the beginning of a header."""
    with path.open("rb") as file:
        start = file.read(len(FIRST_BYTES))
    return FIRST_BYTES.startswith(start)

"""Binary format of a design: all computed numbers that the core in C needs.

    offset  size  content
    0       8     magic: "CUSHLIVE"
    8       4     uint32: format version
    12      4     uint32: total size in bytes, including the checksum
    16      4     uint32: number of records
    20      4     uint32: reserved, 0
    24            the records, one after another
    end-8   4     uint32: CRC-32 (zlib) of all bytes before it
    end-4   4     uint32: reserved, 0

    record
    0       36    name: ASCII, padded with zero bytes
    36      4     uint32: kind: 0 count, 1 number, 2 array
    40      4     uint32: rows of a two-dimensional array; otherwise 0
    44      4     uint32: columns, or length of a one-dimensional array; otherwise 1
    48            the values, 8 bytes each: int64 for a count, float64 otherwise

Numbers are little-endian. Values are aligned to 8 bytes. Records are sorted by name.
"""

import struct
import zlib

import numpy as np

from device.errors import UsageError
from device.units import Record, Records

MAGIC = b"CUSHLIVE"
FORMAT_VERSION = 4  # increase it if the name or the meaning of a value changes

HEADER = struct.Struct("<8sIII4x")
RECORD = struct.Struct("<36sIII")
CHECKSUM = struct.Struct("<I4x")
COUNT, NUMBER, ARRAY = range(3)


def pack(values: Records) -> bytes:
    """Return the bytes of a design with these values."""
    records = [_record(name, values[name]) for name in sorted(values)]
    body = b"".join(records)
    size = HEADER.size + len(body) + CHECKSUM.size
    head = HEADER.pack(MAGIC, FORMAT_VERSION, size, len(records))
    return head + body + CHECKSUM.pack(zlib.crc32(body, zlib.crc32(head)))


def unpack(blob: bytes) -> Records:
    """Return a design's values; arrays are read-only. UsageError: `blob` is not a valid design."""
    if blob[: len(MAGIC)] != MAGIC:
        raise UsageError(f"not a design of the live form: does not begin with {MAGIC.decode()}")
    if len(blob) < HEADER.size + CHECKSUM.size:
        raise UsageError(f"the design is cut: {len(blob)} bytes are less than its header")
    _, version, size, count = HEADER.unpack_from(blob)
    if version != FORMAT_VERSION:
        raise UsageError(
            f"the design has format version {version}; allowed: {FORMAT_VERSION}; make it again"
        )
    if size != len(blob):
        raise UsageError(f"the design is cut or too long: {len(blob)} bytes instead of {size}")
    end = size - CHECKSUM.size
    if blob[end:] != CHECKSUM.pack(zlib.crc32(blob[:end])):
        raise UsageError("the design is damaged: its checksum does not fit")
    values: Records = {}
    offset = HEADER.size
    try:
        for _ in range(count):
            name, value, offset = _read(blob, offset, end)
            values[name] = value
    except (struct.error, UnicodeDecodeError) as error:
        raise UsageError(f"the design is damaged: {error}") from error
    if offset != end:
        raise UsageError("the design is damaged: its records do not fill it")
    return values


def _record(name: str, value: Record) -> bytes:
    if isinstance(value, np.ndarray):
        rows, columns = value.shape if value.ndim == 2 else (0, value.size)
        return RECORD.pack(name.encode(), ARRAY, rows, columns) + value.astype("<f8").tobytes()
    if isinstance(value, int):
        return RECORD.pack(name.encode(), COUNT, 0, 1) + struct.pack("<q", value)
    return RECORD.pack(name.encode(), NUMBER, 0, 1) + struct.pack("<d", value)


def _read(blob: bytes, offset: int, end: int) -> tuple[str, Record, int]:
    """Return name and value of the record at an offset, and the offset of the next record."""
    padded, kind, rows, columns = RECORD.unpack_from(blob, offset)
    name = padded.rstrip(b"\0").decode("ascii")
    first = offset + RECORD.size
    after = first + 8 * (max(rows, 1) * columns)
    if after > end:
        raise UsageError(f"the design is damaged: {name} is longer than the design")
    if kind == ARRAY:
        array = np.frombuffer(blob, "<f8", (after - first) // 8, first).astype(np.float64)
        array.flags.writeable = False
        return name, array.reshape(rows, columns) if rows else array, after
    if kind not in (COUNT, NUMBER) or (rows, columns) != (0, 1):
        raise UsageError(f"the design is damaged: {name} is of no known kind")
    (value,) = struct.unpack_from("<q" if kind == COUNT else "<d", blob, first)
    return name, value, after

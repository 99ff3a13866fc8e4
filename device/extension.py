"""Checks C libraries before the system loads them."""

import struct
from pathlib import Path

LOADED = 1  # PT_LOAD: type of an ELF segment that is mapped into memory

# struct formats: offset, length and count of the program headers; then one program header.
_OF_32_BITS, _OF_64_BITS = ("28xI10xHH", "II8xI"), ("32xQ14xHH", "I4xQ16xQ")


def refuse_cut_off(path: Path) -> None:
    """Raise ImportError for an unreadable file, and for an ELF file that lacks a part of a segment.

    The system's loader does not report the missing part; a later access ends the process (SIGBUS).
    """
    try:
        with path.open("rb") as file:
            head = file.read(64)
            if len(head) < 64 or head[:4] != b"\x7fELF":
                return
            order = "<" if head[5] == 1 else ">"
            place, part = _OF_64_BITS if head[4] == 2 else _OF_32_BITS
            where, length, count = struct.unpack_from(order + place, head)
            file.seek(where)
            headers = file.read(length * count)
            size = path.stat().st_size
    except OSError as error:
        raise ImportError(f"{path} cannot be read ({error.strerror})") from error
    if len(headers) == length * count:
        parts = (
            struct.unpack_from(order + part, headers, first)
            for first in range(0, len(headers), max(1, length))
        )
        if all(first + mapped <= size for kind, first, mapped in parts if kind == LOADED):
            return
    raise ImportError(f"{path} is cut off")

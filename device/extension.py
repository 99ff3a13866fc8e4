"""Checks libraries in C before the system loads them."""

from __future__ import annotations

import struct
from pathlib import Path

LOADED = 1  # PT_LOAD, the type of a part of an ELF file that is mapped into memory


def refuse_cut_off(path: Path) -> None:
    """Raise ImportError for an ELF file that ends before the end of a part to be mapped.

    The system's loader does not check this: it maps the missing part, and the process ends by
    SIGBUS. The loader reports all other faults itself.
    """
    try:
        with path.open("rb") as file:
            head = file.read(64)
            if len(head) < 64 or head[:4] != b"\x7fELF":
                return
            order = "<" if head[5] == 1 else ">"
            # Offset, length and count of the program headers; a header describes a mapped part.
            if head[4] == 2:
                place, part = "32xQ14xHH", "I4xQ16xQ"
            else:
                place, part = "28xI10xHH", "II8xI"
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

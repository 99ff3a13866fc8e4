"""The lines of an index file, one after another, sound or not."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path

from audioflinger_hook.capture.format import (
    FIRST_BYTES,
    LINE_BYTES_MAX,
    Record,
    parse_line,
)
from device.errors import UsageError


def records(path: Path) -> Generator[Record | None, None, None]:
    """Yield the record of every line, or None for a torn or damaged one.

    Memory stays flat. Raises UsageError where the file cannot be read.
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
    """The first sound line: the header, or another where the header is damaged; or None."""
    with contextlib.closing(records(path)) as found:
        return next((record for record in found if record is not None), None)


def begins_like_an_index(path: Path) -> bool:
    """Return whether the file holds only the beginning of a header."""
    with path.open("rb") as file:
        start = file.read(len(FIRST_BYTES))
    return FIRST_BYTES.startswith(start)

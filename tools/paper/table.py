"""A figure's numbers as a CSV file: named columns of equal length."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from device.atomic_file import write_bytes_atomically
from device.errors import InternalError

DIGITS = 7
"""A 48 kHz clock still tells its frames apart after some seconds."""


def write_table(path: Path, columns: Mapping[str, Sequence[float] | np.ndarray]) -> None:
    """The file holds a line of names and one a row; what is not a number is left empty.

    Raises
    ------
    InternalError
        Columns differ in length. For files that cannot be written see `AtomicFile`.
    """
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InternalError(f"columns of {path.name} differ in length: {lengths}")
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(_text, row)) for row in rows)]
    write_bytes_atomically(path, ("\n".join(lines) + "\n").encode())


def _text(number: float) -> str:
    return "" if math.isnan(number) else f"{number:.{DIGITS}g}"

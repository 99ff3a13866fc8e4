"""Writes a figure's numbers as CSV: named columns of equal length."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from device.atomic_file import write_bytes_atomically
from device.errors import InternalError

DIGITS = 7  # significant digits: enough to distinguish frames at 48 kHz in the first minute


def write_table(path: Path, columns: Mapping[str, Sequence[float] | np.ndarray]) -> None:
    """Write a header line and one line for each row; NaN is an empty field.

    InternalError: columns differ in length. For errors of writing see `AtomicFile`.
    """
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InternalError(f"columns of {path.name} differ in length: {lengths}")
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(_text, row)) for row in rows)]
    write_bytes_atomically(path, ("\n".join(lines) + "\n").encode())


def _text(number: float) -> str:
    return "" if math.isnan(number) else f"{number:.{DIGITS}g}"

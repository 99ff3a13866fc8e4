"""Numbers as text, many at a time, with the digits of Python's `repr` of the rounded values."""

import numpy as np
from numpy.typing import NDArray

from device.units import FloatArray

Text = tuple[NDArray[np.uint8], NDArray[np.bool_]]
"""ASCII characters, (n, width), and which of them belong to the text, (n, width)."""

SMALL_FROM = 4  # `repr` has an exponent for numbers below 10**-4


def decimal_text(numbers: FloatArray, decimals: int) -> Text:
    """Return (n,) numbers as text, rounded to `decimals` places. At least one place is shown."""
    units = np.rint(np.abs(numbers) * 10.0**decimals).astype(np.int64)
    whole = max(1, len(str(units.max(initial=0))) - decimals)
    digits = units[:, None] // 10 ** np.arange(whole + decimals - 1, -1, -1) % 10
    shown = digits > 0
    shown[:, whole - 1 : whole + 1] = True
    shown[:, :whole] = np.logical_or.accumulate(shown[:, :whole], axis=1)
    shown[:, whole:] = np.logical_or.accumulate(shown[:, : whole - 1 : -1], axis=1)[:, ::-1]
    text = np.insert(digits + ord("0"), whole, ord("."), axis=1).astype(np.uint8)
    shown = np.insert(shown, whole, values=True, axis=1)
    small = (units > 0) & (units < 10 ** max(0, decimals - SMALL_FROM))
    if small.any():
        values, which = np.unique(units[small], return_inverse=True)
        words = [repr(value / 10**decimals) for value in values.tolist()]
        table = np.array(words, f"S{text.shape[1]}").view(np.uint8).reshape(len(words), -1)
        text[small], shown[small] = table[which], table[which] > 0
    return np.insert(text, 0, ord("-"), axis=1), np.insert(shown, 0, np.signbit(numbers), axis=1)


def point_texts(columns: list[Text], sizes: NDArray[np.intp]) -> list[bytes]:
    """Return JSON arrays of points, such as b"[[0.1,2.0],[0.2,3.0]]", one for each list of points.

    columns: one number of each point. sizes: number of points of each list, 1 or more.
    """
    count = len(columns[0][0])

    def mark(sign: str) -> Text:
        return np.full((count, 1), ord(sign), np.uint8), np.ones((count, 1), np.bool_)

    row = [mark("[")]
    for column in columns:
        row += [column, mark(",")]
    parts = [*row[:-1], mark("]"), mark(",")]
    text, shown = (np.concatenate(both, axis=1) for both in zip(*parts, strict=True))
    ends = np.cumsum(np.count_nonzero(shown, axis=1))[np.cumsum(sizes) - 1].tolist()
    content = text[shown].tobytes()
    return [b"[%b]" % content[a : b - 1] for a, b in zip([0, *ends[:-1]], ends, strict=True)]

"""Numbers as JSON text, many at a time, with the digits of Python's `repr` of rounded values."""

import numpy as np
from numpy.typing import NDArray

from device.units import FloatArray


def decimal_text(numbers: FloatArray, decimals: int) -> NDArray[np.uint8]:
    """Return (n,) numbers, rounded to `decimals` places, as ASCII, (n, width), padded with 0."""
    units = np.rint(np.abs(numbers) * 10.0**decimals).astype(np.int64)
    whole = max(1, len(str(units.max())) - decimals)
    digits = units[:, None] // 10 ** np.arange(whole + decimals - 1, -1, -1) % 10
    text = np.where(digits > 0, ord("0") + digits, 0).astype(np.uint8)
    # A zero is shown at both sides of the point, and between these and other digits.
    text[:, whole - 1 : whole + 1] |= ord("0")
    shown = (
        np.maximum.accumulate(text[:, :whole], 1),
        np.maximum.accumulate(text[:, : whole - 1 : -1], 1),
    )
    text[np.hstack((shown[0], shown[1][:, ::-1])) > 0] |= ord("0")
    text = np.insert(text, whole, ord("."), axis=1)
    small = (units > 0) & (10**4 * units < 10**decimals)  # where `repr` has an exponent
    if small.any():
        values, place = np.unique(units[small] / 10**decimals, return_inverse=True)
        table = np.array([repr(value) for value in values.tolist()], f"S{text.shape[1]}")
        text[small] = table.view(np.uint8).reshape(len(values), -1)[place]
    return np.insert(text, 0, np.where(np.signbit(numbers), ord("-"), 0), axis=1)


def point_texts(columns: list[NDArray[np.uint8]], sizes: NDArray[np.intp]) -> list[bytes]:
    """Return JSON lists of points, such as b"[0.1,2.0],[0.2,3.0]".

    columns: numbers of the points as text. sizes: number of points of each list, 1 or more.
    """
    ends = np.full((len(columns[0]), 1), ord(","), np.uint8)
    parts = [part for column in columns for part in (ends, column)]
    after = ends.copy()
    after[np.cumsum(sizes) - 1] = ord("\n")
    text = np.hstack([ends - ord(",") + ord("["), *parts[1:], ends - ord(",") + ord("]"), after])
    return text.tobytes().translate(None, b"\0").splitlines()

"""Curves as straight lines between few points."""

from __future__ import annotations

import heapq
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from device.units import FloatArray

TIED = 1e-3  # weight of the curve's own value at a point, in samples, against the fit


def simplify(
    times: FloatArray, values: FloatArray, tolerance: FloatArray, spacing: int, longest: int
) -> NDArray[np.intp]:
    """Return the places of the points to keep, ascending, with the first and the last place.

    The place with the largest error is added until no error is above the tolerance, or until no
    further point is allowed.

    times: (n,) ascending.
    values: (n, k) curves that share their points.
    tolerance: (n, k) largest error allowed at each place.
    spacing: least distance of two points, in places; the last point alone may be nearer.
    longest: largest distance of two points.
    """
    last = len(values) - 1
    if last < 1:
        return np.arange(len(values))
    kept = {0, last}
    edges = [*range(0, last, longest), last]
    if len(edges) > 2 and edges[-1] - edges[-2] < spacing:
        edges.pop(-2)
        if last - edges[-2] > longest:  # still at most `longest` apart
            edges.insert(-1, last - spacing)
    kept.update(edges)
    waiting: list[tuple[float, int, int, int]] = []

    def consider(first: int, end: int) -> None:
        low, high = first + spacing, end - spacing
        if low > high:
            return
        part = slice(low, high + 1)
        share = ((times[part] - times[first]) / (times[end] - times[first]))[:, None]
        line = values[first] + share * (values[end] - values[first])
        error = (np.abs(values[part] - line) / tolerance[part]).max(axis=1)
        worst = int(error.argmax())
        if error[worst] > 1.0:
            heapq.heappush(waiting, (-float(error[worst]), first, low + worst, end))

    for first, end in pairwise(edges):
        consider(first, end)
    while waiting:
        _, first, place, end = heapq.heappop(waiting)
        kept.add(place)
        consider(first, place)
        consider(place, end)
    return np.array(sorted(kept), dtype=np.intp)


def fitted(times: FloatArray, values: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the values at the knots whose straight lines are nearest to a curve by least squares.

    times, values: (n,) the curve. knots: (k,) ascending, within the times.
    """
    if knots.size < 3 or knots[0] == knots[-1]:
        return np.interp(knots, times, values)
    place = np.clip(np.searchsorted(knots, times, "right") - 1, 0, knots.size - 2)
    share = (times - knots[place]) / np.diff(knots)[place]
    size = knots.size
    diagonal = np.bincount(place, (1 - share) ** 2, size) + np.bincount(place + 1, share**2, size)
    beside = np.bincount(place, share * (1 - share), size)
    wanted = np.bincount(place, (1 - share) * values, size)
    wanted += np.bincount(place + 1, share * values, size)
    # A little of the curve itself, so that a knot between two samples has a value.
    bands = np.vstack((np.concatenate(([0.0], beside[:-1])), diagonal + TIED))
    found: FloatArray = solveh_banded(bands, wanted + TIED * np.interp(knots, times, values))
    return found

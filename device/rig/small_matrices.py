"""Many small matrices at once: each entry is a number or an array over all points.

A matrix is a dict from (row, column) to its entry; an absent entry is 0 and costs nothing. With
three to five states this is several times faster than NumPy's stacks of matrices.
"""

import numpy as np

from device.units import FloatArray

Entry = FloatArray | float
SmallMatrix = dict[tuple[int, int], Entry]
Vector = list[Entry]


def multiply(a: SmallMatrix, b: SmallMatrix) -> SmallMatrix:
    """Return a b."""
    result: SmallMatrix = {}
    for (row, inner), left in a.items():
        for (other, column), right in b.items():
            if other == inner:
                term = left * right
                known = result.get((row, column))
                result[row, column] = term if known is None else known + term
    return result


def combine(size: int, diagonal: float, *terms: tuple[float, SmallMatrix]) -> SmallMatrix:
    """Return diagonal I + the sum of factor times matrix; the whole diagonal is present."""
    result: SmallMatrix = {(k, k): diagonal for k in range(size)}
    for factor, matrix in terms:
        for place, entry in matrix.items():
            known = result.get(place)
            term = factor * entry
            result[place] = term if known is None else known + term
    return result


def select_points(matrix: SmallMatrix, points: slice) -> SmallMatrix:
    """Return the matrices at some of the points."""
    return {k: e[points] if isinstance(e, np.ndarray) else e for k, e in matrix.items()}


class Factors:
    """LU factors of many matrices without pivoting, for I - h J with a step that resolves J.

    If a pivot is 0, the solutions are not finite; the caller checks for that.
    """

    def __init__(self, size: int, matrix: SmallMatrix) -> None:
        self._size = size
        self._factors = dict(matrix)
        factors = self._factors
        self._inverse: Vector = []
        for pivot in range(size):
            inverse = 1.0 / factors[pivot, pivot]
            self._inverse.append(inverse)
            for row in range(pivot + 1, size):
                if (row, pivot) not in factors:
                    continue
                share = factors[row, pivot] * inverse
                factors[row, pivot] = share
                for column in range(pivot + 1, size):
                    if (pivot, column) in factors:
                        known = factors.get((row, column), 0.0)
                        factors[row, column] = known - share * factors[pivot, column]

    def solve(self, right: list[Entry | None]) -> list[Entry | None]:
        """Return the solution for one right-hand side; None is 0."""
        solution = list(right)
        factors, size = self._factors, self._size
        for row in range(size):
            for column in range(row):
                solution[row] = _minus(solution[row], factors.get((row, column)), solution[column])
        for row in reversed(range(size)):
            for column in range(row + 1, size):
                solution[row] = _minus(solution[row], factors.get((row, column)), solution[column])
            value = solution[row]
            if value is not None:
                solution[row] = value * self._inverse[row]
        return solution


def _minus(total: Entry | None, factor: Entry | None, value: Entry | None) -> Entry | None:
    if factor is None or value is None:
        return total
    term = factor * value
    return -term if total is None else total - term

"""Many small matrices at once: each entry is a number or an array over all points.

A matrix is a dict from (row, column) to its entry. With three to five states and many zeros this is
several times faster than NumPy's stacks of matrices.
"""

from device.units import FloatArray

Entry = FloatArray | float
SmallMatrix = dict[tuple[int, int], Entry]


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


def add_to_identity(size: int, *terms: tuple[float, SmallMatrix]) -> SmallMatrix:
    """Return I + the sum of factor times matrix; the whole diagonal is present."""
    result: SmallMatrix = {(k, k): 1.0 for k in range(size)}
    for factor, matrix in terms:
        for place, entry in matrix.items():
            known = result.get(place)
            term = factor * entry
            result[place] = term if known is None else known + term
    return result


class Factors:
    """LU factors of many matrices without pivoting, for I - h J with a step that resolves J.

    If a pivot is 0, the solutions are not finite; the caller checks for that.
    """

    def __init__(self, size: int, matrix: SmallMatrix) -> None:
        self._size = size
        self._factors = dict(matrix)
        factors = self._factors
        self._inverse: list[Entry] = []
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
        for row in range(self._size):
            self._eliminate(solution, row, range(row))
        for row in reversed(range(self._size)):
            self._eliminate(solution, row, range(row + 1, self._size))
            value = solution[row]
            if value is not None:
                solution[row] = value * self._inverse[row]
        return solution

    def _eliminate(self, solution: list[Entry | None], row: int, columns: range) -> None:
        for column in columns:
            factor, value, total = self._factors.get((row, column)), solution[column], solution[row]
            if factor is not None and value is not None:
                term = factor * value
                solution[row] = -term if total is None else total - term

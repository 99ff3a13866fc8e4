"""What an effect lets one choose: a typed table with ranges, and the values chosen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

Value = bool | int | float | str
"""What a parameter may hold. Plain Python values: a NumPy scalar is not one."""

Values = Mapping[str, Value]

KINDS: dict[type, tuple[type, ...]] = {
    bool: (bool,),
    int: (int,),
    float: (float, int),
    str: (str,),
}
"""What is taken for a parameter of each kind. Exact types: True is no number."""


@dataclass(frozen=True)
class Parameter:
    """One parameter: kind `bool`, `int`, `float` or `str`, and what it may hold.

    low, high: the closed range of a number, in `unit`; choices: all that a `str` may be (any,
    where there are none). default: None for one that can only be read.
    """

    name: str
    kind: type
    default: Value | None = None
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    unit: str = ""
    meaning: str = ""

    @property
    def read_only(self) -> bool:
        """Whether it can only be read."""
        return self.default is None

    def accepts(self, value: object) -> bool:
        """Return whether it may hold a value; never raises, whatever that is."""
        if type(value) not in KINDS.get(self.kind, ()):
            return False
        if isinstance(value, str):
            return not self.choices or value in self.choices
        if isinstance(value, bool):
            return True
        # False for NaN.
        return isinstance(value, (int, float)) and self.low <= value <= self.high

    def __str__(self) -> str:
        if self.kind is bool:
            allowed = "true or false"
        elif self.kind is str:
            allowed = ", ".join(self.choices) or "any text"
        else:
            allowed = f"{self.low:g} to {self.high:g} {self.unit}".rstrip()
        return f"{self.name} ({'read only' if self.read_only else allowed})"


class ParameterValues:
    """The values of a table's parameters: what was set is what one gets.

    A new value is first proposed, so that whoever knows which values go together may refuse,
    and then taken. Held by one thread at a time.
    """

    def __init__(self, table: Iterable[Parameter]) -> None:
        self._table = {parameter.name: parameter for parameter in table}
        self._values: dict[str, Value] = {
            parameter.name: parameter.default
            for parameter in self._table.values()
            if parameter.default is not None
        }
        self._staged: dict[str, Value] = {}

    def __getitem__(self, name: str) -> Value:
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def proposed(self, name: str, value: Value) -> dict[str, Value] | None:
        """Return all values with one of them new, or None where it is out of range."""
        return self._values | {name: value} if self._fits(name, value) else None

    def stage(self, name: str, value: Value) -> bool:
        """Put a new value aside and return True, or False where it is out of range."""
        if not self._fits(name, value):
            return False
        self._staged[name] = value
        return True

    def proposed_together(self) -> dict[str, Value]:
        """Return all values with those put aside, which are put aside no more."""
        staged, self._staged = self._staged, {}
        return self._values | staged

    def all(self) -> Values:
        """Return every value by name."""
        return self._values

    def take(self, values: Values) -> None:
        """Hold a complete set of values, as proposed."""
        self._values = dict(values)

    def _fits(self, name: str, value: Value) -> bool:
        return name in self._values and self._table[name].accepts(value)

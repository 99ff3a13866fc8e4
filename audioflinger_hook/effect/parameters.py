"""What an effect lets one choose: a typed table with ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
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

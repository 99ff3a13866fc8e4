"""Narrows the allowed values of a key to those that fit the present values of the other keys."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from device.values import Choice, Described, Number


def allowed_now(owner: Described, field: str) -> dict[str, Any]:
    """Return the part of the field's JSON Schema that the other values narrow; {} if none does.

    owner: settings whose present values do not contradict each other.
    """
    described = owner.DESCRIPTIONS[field]
    values = {one.name: getattr(owner, one.name) for one in fields(owner)}  # type: ignore[arg-type]

    def fits(value: Any) -> bool:
        return not owner.contradictions({**values, field: value})

    if isinstance(described, Choice):
        words = [word for word in described.words if fits(word)]
        return {} if len(words) == len(described.words) else {"enum": words}
    if not isinstance(described, Number):
        return {}
    present, schema = values[field], described.json_schema()
    if not isinstance(present, int | float):
        present = 0.0 if schema["minimum"] <= 0.0 <= schema["maximum"] else schema["maximum"]
    if not fits(present):
        return {}
    ends = ((name, schema[name]) for name in ("minimum", "maximum"))
    return {name: _limit(fits, present, end) for name, end in ends if not fits(end)}


def _limit(fits: Callable[[float], bool], inside: float, outside: float) -> float:
    for _ in range(40):  # halvings of the range
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if fits(middle) else (inside, middle)
    return inside

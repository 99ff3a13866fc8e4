"""Records that a file keeps for the report: of the types that they say, or refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")

KINDS: Mapping[str, tuple[type, ...]] = {
    "str": (str,),
    "bool": (bool,),
    "int": (int,),
    "float": (int, float),
    "Numbers": (list, tuple),
}


def typed(record: Record) -> Record:
    """Return the record as it is.

    Raises
    ------
    TypeError
        A field holds what its annotation does not allow; None is allowed where that ends so.
    """
    for field in fields(record):
        value = getattr(record, field.name)
        name = str(field.type)
        if value is None and name.endswith(" | None"):
            continue
        allowed = KINDS[name.removesuffix(" | None")]
        if not _is_one(value, allowed):
            raise TypeError(f"{field.name} is {value!r}, not {name}")
        if allowed is KINDS["Numbers"]:
            for entry in value:
                if entry is not None and not _is_one(entry, KINDS["float"]):
                    raise TypeError(f"{field.name} holds {entry!r}, not numbers")
    return record


def _is_one(value: Any, kinds: tuple[type, ...]) -> bool:
    return isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool))

"""Conversion of dataclasses to JSON and back, with strict checks of keys and types."""

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import MappingProxyType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from audioflinger_hook.service.one_line import one_line
from device.errors import UsageError

T = TypeVar("T")

_SCALARS = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}


def to_json(document: Any) -> str:
    """Return a dataclass as one line of JSON. ValueError: a number is not finite."""
    return json.dumps(document, allow_nan=False, default=_plain)


def from_json(kind: type[T], text: str | bytes) -> T:
    """Return the dataclass in a JSON document; the inverse of `to_json`.

    UsageError: the text is not JSON, a key is missing, unknown or repeated, or a value is invalid.
    """
    try:
        document = json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:  # RecursionError: deeply nested brackets
        raise UsageError(f"the document is not JSON: {one_line(str(error))}") from error
    return from_document(kind, document)


def from_document(kind: type[T], document: object) -> T:
    """Return the dataclass in a parsed JSON document. UsageError: see `from_json`."""
    return _typed(kind, document, "")  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key.value: item for key, item in value.items()}
    return value.value  # member of an enumeration


def _typed(kind: Any, value: Any, where: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        (other,) = (argument for argument in arguments if argument is not type(None))
        return None if value is None else _typed(other, value, where)
    if is_dataclass(kind):
        return kind(**_typed_items(get_type_hints(kind), value, where))  # type: ignore[operator]
    if origin is tuple:
        if not isinstance(value, list):
            raise _wrong(where, value, "a list")
        return tuple(_typed(arguments[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        members, item_kind = arguments
        items = _typed_items({member.value: item_kind for member in members}, value, where)
        return MappingProxyType({member: items[member.value] for member in members})
    if isinstance(kind, type) and issubclass(kind, Enum):
        by_value = {member.value: member for member in kind}
        if type(value) is str and value in by_value:
            return by_value[value]
        raise _wrong(where, value, ", ".join(by_value))
    if kind is float and type(value) in (int, float):
        # An integer of hundreds of digits may be too large for a float.
        number = float(value) if type(value) is float or abs(value) < 2**1023 else math.inf
        if math.isfinite(number):
            return number
        raise _wrong(where, value, "a finite number")
    if type(value) is kind:  # isinstance would accept True as an int
        return value
    raise _wrong(where, value, _SCALARS[kind])


def _typed_items(kinds: dict[str, Any], value: Any, where: str) -> dict[str, Any]:
    """Return the converted values of a JSON object, which must have exactly the keys of `kinds`."""
    if not isinstance(value, dict):
        raise _wrong(where, value, "an object")
    path = f"{where}." if where else ""
    if missing := [name for name in kinds if name not in value]:
        raise UsageError(f"the document has no {path}{missing[0]}; give every key")
    if unknown := [name for name in value if name not in kinds]:
        key = one_line(path + unknown[0], 60)
        raise UsageError(f"the document has the unknown key {key}; allowed: {', '.join(kinds)}")
    return {name: _typed(kinds[name], value[name], path + name) for name in kinds}


def _wrong(where: str, value: Any, allowed: str) -> UsageError:
    # The conversion of a long integer to decimal takes quadratic time, so use hexadecimal.
    is_long = type(value) is int and abs(value) > 10**15
    shown = one_line(hex(value) if is_long else repr(value), 60)
    return UsageError(f"the document's {where or 'whole'} is {shown}; allowed: {allowed}")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) != len(pairs):
        raise ValueError("a key is given twice")
    return keys


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")

"""Frozen dataclasses as JSON documents and back, with nothing left over and nothing guessed."""

from __future__ import annotations

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


def to_json(document: Any) -> str:
    """Return a dataclass as one line of JSON; enums by their value.

    Raises
    ------
    ValueError
        A number is not finite; JSON has none of those.
    """
    return json.dumps(_plain(document), allow_nan=False, separators=(", ", ": "))


def from_json(kind: type[T], text: str | bytes) -> T:
    """Return the dataclass that a JSON document holds; `to_json` backwards.

    Raises
    ------
    UsageError
        Not JSON, or not exactly this: a key too many, too few or twice, a value of another type,
        a number that is not finite. The message names the key, the value and what is allowed.
    """
    try:
        document = json.loads(text, object_pairs_hook=_once, parse_constant=_refuse_constant)
    # RecursionError: thousands of brackets.
    except (ValueError, RecursionError) as error:
        raise UsageError(
            f"the document is not JSON: {one_line(str(error))}; give one JSON document"
        ) from error
    return _typed(kind, document, "")  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {_plain(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


def _typed(kind: Any, value: Any, where: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        (other,) = (argument for argument in arguments if argument is not type(None))
        return None if value is None else _typed(other, value, where)
    if is_dataclass(kind):
        return _typed_dataclass(kind, value, where)
    if origin is tuple:
        if not isinstance(value, list):
            raise _wrong(where, value, "a list")
        return tuple(_typed(arguments[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        names = [member.value for member in arguments[0]]
        _refuse_other_keys(value, names, where)
        items = {
            member: _typed(arguments[1], value[member.value], _join(where, member.value))
            for member in arguments[0]
        }
        return MappingProxyType(items)
    if isinstance(kind, type) and issubclass(kind, Enum):
        for member in kind:
            if type(value) is str and value == member.value:
                return member
        raise _wrong(where, value, ", ".join(member.value for member in kind))
    return _typed_scalar(kind, value, where)


def _typed_dataclass(kind: Any, value: Any, where: str) -> Any:
    hints = get_type_hints(kind)
    _refuse_other_keys(value, list(hints), where)
    return kind(**{name: _typed(hints[name], value[name], _join(where, name)) for name in hints})


def _typed_scalar(kind: Any, value: Any, where: str) -> Any:
    if kind is float and type(value) in (int, float):
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            number = math.inf
        if math.isfinite(number):
            return number
        raise _wrong(where, value, "a finite number")
    if type(value) is kind:  # True is no number here
        return value
    allowed = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}
    raise _wrong(where, value, allowed[kind])


def _refuse_other_keys(value: Any, names: list[str], where: str) -> None:
    if not isinstance(value, dict):
        raise _wrong(where, value, "an object")
    for name in names:
        if name not in value:
            raise UsageError(f"the document has no {_join(where, name)}; give every key")
    for name in value:
        if name not in names:
            raise UsageError(
                f"the document has the unknown key {one_line(_join(where, name), 60)}; "
                f"allowed: {', '.join(names)}"
            )


def _wrong(where: str, value: Any, allowed: str) -> UsageError:
    # In hexadecimal, digits cost no time that grows with their number squared.
    long = type(value) is int and abs(value) > 10**15
    shown = one_line(hex(value) if long else repr(value), 60)
    return UsageError(f"the document's {where or 'whole'} is {shown}; allowed: {allowed}")


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) != len(pairs):
        raise ValueError("a key stands there twice")
    return keys


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")

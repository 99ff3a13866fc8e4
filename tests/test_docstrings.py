"""Every parameter of what a package offers is documented, as `name: text` or in a section."""

import importlib
import inspect
import pkgutil
import re
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import pytest

import audioflinger_hook
import device

SECTION = re.compile(
    r"^(\w[\w ]*)\n-{3,}\n(.*?)(?=^\w[\w ]*\n-{3,}\n|\Z)", re.MULTILINE | re.DOTALL
)

NAMED = re.compile(r"(?:^|(?<=[.;]\s))(\w+(?:, \w+)*):\s", re.MULTILINE)


def public_callables() -> list[tuple[str, Any]]:
    """Return (full name, object) of the functions and classes in each package's `__all__`."""
    found: dict[int, tuple[str, Any]] = {}
    for root in (audioflinger_hook, device):
        names = [root.__name__]
        names += [
            info.name
            for info in pkgutil.walk_packages(root.__path__, f"{root.__name__}.")
            if info.ispkg
        ]
        for name in names:
            package = importlib.import_module(name)
            for offered in getattr(package, "__all__", ()):
                thing = getattr(package, offered)
                if inspect.isfunction(thing) or inspect.isclass(thing):
                    found.setdefault(id(thing), (f"{name}.{offered}", thing))
    return sorted(found.values(), key=lambda entry: entry[0])


def parameters_of(thing: Any) -> set[str]:
    """Return the names that a caller may give to a function or a constructor."""
    if inspect.isclass(thing):
        if issubclass(thing, Enum) or getattr(thing, "_is_protocol", False):
            return set()
        if issubclass(thing, BaseException) and "__init__" not in vars(thing):
            return set()
        if is_dataclass(thing):
            return {field.name for field in fields(thing) if field.init}
    try:
        signature = inspect.signature(thing)
    except ValueError:
        return set()
    return {name for name in signature.parameters if not name.startswith("_")}


@pytest.mark.parametrize(("name", "thing"), [pytest.param(*e, id=e[0]) for e in public_callables()])
def test_every_parameter_of_a_public_callable_is_documented(name: str, thing: Any) -> None:
    text = inspect.getdoc(thing) or ""
    assert text.splitlines()[0].rstrip().endswith("."), f"{name}: the first line is no sentence"
    # before a colon, or listed by Parameters or Attributes
    described = {name for names in NAMED.findall(text) for name in names.split(", ")}
    sections = {match[1]: match[2] for match in SECTION.finditer(text)}
    for section in ("Parameters", "Attributes"):
        for names in re.findall(r"(?m)^([\w*, ]+?)(?: ?:.*)?$", sections.get(section, "")):
            described |= {name.strip(" *") for name in names.split(",")}
    missing = parameters_of(thing) - described - {"args", "kwargs"}
    assert not missing, f"{name}: the docstring does not describe {', '.join(sorted(missing))}"


def test_the_packages_offer_something() -> None:
    assert len(public_callables()) > 50

import ast
import importlib
import inspect
import pkgutil
import re
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import audioflinger_hook
import device
from tools.guards import MUTATIONS, Mutation

ROOT = Path(__file__).resolve().parents[1]
TOP_LEVEL = ("audioflinger_hook", "device")
PAGE = (ROOT / "docs/architecture.md").read_text()

TABLE_OF_PACKAGES = PAGE.partition("\n## Packages\n")[2].partition("\n## ")[0]

# The packages in the order of the page's table: a package may import packages below it.
PACKAGES = [
    package.replace("/", ".")
    for package in re.findall(r"^\| `([\w/]+)` \|", TABLE_OF_PACKAGES, re.MULTILINE)
]

# Held whatever the page says.
IO = r"(soundfile|os|io|time|pathlib|rich|pulsectl|pyaudio|threading|socket|subprocess|logging)\b"
FORBIDDEN = [
    ("device", r"(audioflinger_hook|tools|tests)\b"),
    ("audioflinger_hook", r"(tools|tests)\b"),
    ("audioflinger_hook/core", r"audioflinger_hook(?!\.core\b)"),
    ("audioflinger_hook/transform", r"audioflinger_hook(?!\.(transform|core)\b)"),
    ("audioflinger_hook/transform", r"device(?!\.(errors|layouts|units|values)\b)"),
    ("audioflinger_hook/transform", IO),
    ("audioflinger_hook/mixer", r"audioflinger_hook\.(effect|sources|transform|capture)\b"),
    ("audioflinger_hook/mixer", IO),
    ("audioflinger_hook/effect", r"audioflinger_hook\.(sources|capture)\b"),
]
ROOT_MODULES = {"__init__", "__main__", "errors"}


def modules_of(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


@cache
def imports_of(path: Path) -> list[str]:
    """Return the full name of everything that a module imports, wherever in it."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def package_of(name: str) -> str | None:
    """Return the package that a dotted name lies in; None for names that are not ours."""
    top, *rest = name.split(".")
    if top not in TOP_LEVEL:
        return None
    package = f"{top}.{rest[0]}" if rest else top
    return package if package in PACKAGES else top


@pytest.mark.parametrize(("folder", "pattern"), FORBIDDEN)
def test_no_import_runs_against_the_flow(folder: str, pattern: str) -> None:
    modules = modules_of(folder)
    assert modules
    wrong = [
        f"{module.relative_to(ROOT)} imports {name}"
        for module in modules
        for name in imports_of(module)
        if re.match(pattern, name)
    ]
    assert not wrong


@pytest.mark.parametrize("top", TOP_LEVEL)
def test_the_table_lists_every_package_and_no_other(top: str) -> None:
    folders = {
        f"{top}.{path.name}"
        for path in (ROOT / top).iterdir()
        if path.is_dir() and list(path.rglob("*.py"))
    }
    listed = {package for package in PACKAGES if package.startswith(f"{top}.")}
    modules = {name for name in listed if (ROOT / f"{name.replace('.', '/')}.py").is_file()}
    assert listed - modules == folders


def test_a_package_imports_only_packages_below_it_in_the_table() -> None:
    floors = {package: len(PACKAGES) - index for index, package in enumerate(PACKAGES)}
    wrong = []
    for top in TOP_LEVEL:
        for module in modules_of(top):
            dotted = ".".join(module.relative_to(ROOT).with_suffix("").parts)
            if module.parent == ROOT / top and module.stem in ROOT_MODULES:
                continue  # what a top-level package offers comes from all of its packages
            package = package_of(dotted)
            for name in imports_of(module):
                found = package_of(name)
                if found in (None, package, "audioflinger_hook"):
                    continue
                if floors[found or ""] >= floors[package or ""]:
                    wrong.append(f"{module.relative_to(ROOT)} imports {name}")
    assert not wrong


def test_every_module_of_the_first_package_is_in_a_listed_package() -> None:
    loose = {path.stem for path in (ROOT / "audioflinger_hook").glob("*.py")} - ROOT_MODULES
    assert not loose


def test_nothing_reads_a_clock_outside_the_commands_and_the_streams() -> None:
    readers = [
        str(module.relative_to(ROOT))
        for top in TOP_LEVEL
        for module in modules_of(top)
        if {name.partition(".")[0] for name in imports_of(module)} & {"time", "datetime"}
    ]
    # what comes from outside is stamped where it comes in
    allowed = ("audioflinger_hook/cli/", "device/server/", "device/stream/")
    assert [reader for reader in readers if not reader.startswith(allowed)] == []


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


@pytest.mark.parametrize("mutation", MUTATIONS, ids=[one.guard for one in MUTATIONS])
def test_each_guard_is_where_the_list_says_and_has_its_test(mutation: Mutation) -> None:
    assert (ROOT / mutation.file).read_text("utf-8").count(mutation.old) == 1
    file, _, name = mutation.test.partition("::")
    assert f"def {name}" in (ROOT / file).read_text("utf-8")

"""The imports run the way the page docs/architecture.md says, and the page names what there is."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("audioflinger_hook", "device")
PAGE = (ROOT / "docs/architecture.md").read_text()

# What a part may import of ours: the last column of the page's table.
TABLE = {
    part: {allowed} if allowed == "everything" else set(re.findall(r"`(\w+)`", allowed))
    for part, allowed in re.findall(r"^\| `([\w/.]+)` \|.*\| ([^|]+) \|$", PAGE, re.MULTILINE)
    if part.split("/")[0] in PACKAGES
}

# Held whatever the page says.
OURS_BUT_TRANSFORM = r"audioflinger_hook(?!\.transform\b)"
IO = r"(soundfile|os|io|time|pathlib|rich|pulsectl|pyaudio|threading|socket|subprocess|logging)\b"
FORBIDDEN = [
    ("device", "audioflinger_hook"),
    ("audioflinger_hook/transform", OURS_BUT_TRANSFORM),
    ("audioflinger_hook/transform", r"device(?!\.(errors|extension)\b)"),
    ("audioflinger_hook/transform", IO),
    ("audioflinger_hook/mixer", r"audioflinger_hook\.(effect|clients|taps|transform|capture)\b"),
    ("audioflinger_hook/mixer", IO),
    ("audioflinger_hook/effect", r"audioflinger_hook\.(mixer|clients|taps|capture)\b"),
    ("audioflinger_hook/capture", r"audioflinger_hook\.(mixer|effect|clients|taps|transform)\b"),
    ("audioflinger_hook/taps", r"audioflinger_hook\.(mixer|effect|clients|scenes)\b"),
    ("audioflinger_hook/clients", r"audioflinger_hook\.(effect|capture|transform)\b"),
    ("audioflinger_hook/scenes", r"audioflinger_hook\.(?!scenes\b|mixer\.PcmFormat$)"),
]

# Folders of which the page names every module, because sound passes through them.
FLOW = ("taps", "clients", "mixer", "effect", "capture")


def modules_of(part: str) -> list[Path]:
    path = ROOT / part
    return [path] if path.suffix == ".py" else sorted(path.rglob("*.py"))


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


def part_of_ours(name: str) -> str | None:
    """Return the part that an import leads to, as the page calls it; None where it is not ours."""
    package, _, rest = name.partition(".")
    if package == "device":
        return package
    return rest.partition(".")[0] if package == "audioflinger_hook" else None


def parts() -> list[str]:
    """Return every part of ours: the package `device`, folders and modules of the other one."""
    entries = (path for path in (ROOT / "audioflinger_hook").iterdir() if path.name[0] != "_")
    found = [f"audioflinger_hook/{p.name}" for p in entries if p.is_dir() or p.suffix == ".py"]
    return ["device", *sorted(found)]


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


def test_the_table_has_every_part_and_no_other() -> None:
    assert sorted(TABLE) == sorted(parts())


@pytest.mark.parametrize("part", parts())
def test_a_part_imports_just_what_the_table_says(part: str) -> None:
    imported = {
        found
        for module in modules_of(part)
        for name in imports_of(module)
        if (found := part_of_ours(name)) and found != "__version__"
    }
    imported.discard(Path(part).stem)
    if "everything" not in TABLE[part]:
        assert imported == TABLE[part]


def test_only_the_commands_and_the_bench_import_either_of_them() -> None:
    users = {
        part
        for part in parts()
        for module in modules_of(part)
        for name in imports_of(module)
        if part_of_ours(name) in {"cli", "bench"}
    }
    assert users <= {"audioflinger_hook/cli", "audioflinger_hook/bench"}


def test_nothing_reads_a_clock_outside_the_commands_and_the_bench() -> None:
    readers = [
        str(module.relative_to(ROOT))
        for package in PACKAGES
        for module in sorted((ROOT / package).rglob("*.py"))
        if {name.partition(".")[0] for name in imports_of(module)} & {"time", "datetime"}
    ]
    # what comes from outside is stamped where it comes in
    allowed = ("audioflinger_hook/cli/", "audioflinger_hook/bench/", "device/server/")
    assert [reader for reader in readers if not reader.startswith(allowed)] == []


@pytest.mark.parametrize(
    "module",
    [
        path.relative_to(ROOT).as_posix()
        for folder in (*(f"audioflinger_hook/{name}" for name in FLOW), "device")
        for path in modules_of(folder)
        if path.stem != "__init__"
    ],
)
def test_the_page_names_every_module_that_sound_passes(module: str) -> None:
    path = Path(module)
    names = (f"{path.parent.name}/{path.name}", path.name)
    assert any(re.search(rf"(?<![\w/]){re.escape(name)}(?!\w)", PAGE) for name in names)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"[\w/]+\.py\b", PAGE))))
def test_every_module_on_the_page_exists(name: str) -> None:
    if name == "tests/test_architecture.py":
        return
    found = [
        path
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if f"/{path.relative_to(ROOT).as_posix()}".endswith(f"/{name}")
    ]
    assert found


@pytest.mark.parametrize("name", sorted(set(re.findall(r"\b(\w+)/(?=\s)", PAGE))))
def test_every_folder_in_the_picture_exists(name: str) -> None:
    assert any((ROOT / package / name).is_dir() for package in ("", *PACKAGES))

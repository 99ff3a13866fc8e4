"""The imports run the way the picture in docs/architecture.md says."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

FORBIDDEN = [
    ("device", "audioflinger_hook"),
    ("audioflinger_hook/transform", r"audioflinger_hook(?!\.transform)"),
    ("audioflinger_hook/transform", r"device(?!\.errors)"),
    ("audioflinger_hook/transform", r"(soundfile|os|io|time|pathlib|rich|pulsectl|pyaudio)\b"),
    ("audioflinger_hook/taps", r"audioflinger_hook\.(effect|chain|cli|render)"),
    ("audioflinger_hook/effect", r"audioflinger_hook\.(taps|chain|cli|render)"),
    ("audioflinger_hook/scenes", r"audioflinger_hook(?!\.scenes)"),
]


def imports_of(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            names.append(node.module or "")
    return names


@pytest.mark.parametrize(("folder", "pattern"), FORBIDDEN)
def test_no_import_runs_against_the_flow(folder: str, pattern: str) -> None:
    modules = sorted((ROOT / folder).rglob("*.py"))
    assert modules
    wrong = [
        f"{module.relative_to(ROOT)} imports {name}"
        for module in modules
        for name in imports_of(module)
        if re.match(pattern, name)
    ]
    assert not wrong


def test_nothing_reads_a_clock_outside_the_commands_and_the_bench() -> None:
    readers = [
        str(module.relative_to(ROOT))
        for package in ("audioflinger_hook", "device")
        for module in sorted((ROOT / package).rglob("*.py"))
        if "time" in imports_of(module) or "datetime" in imports_of(module)
    ]
    allowed = ("audioflinger_hook/cli/", "audioflinger_hook/bench/")
    assert [reader for reader in readers if not reader.startswith(allowed)] == []


def test_the_architecture_page_names_every_folder_and_no_other() -> None:
    page = (ROOT / "docs/architecture.md").read_text()
    for package in ("audioflinger_hook", "device"):
        for path in (ROOT / package).iterdir():
            if path.name.startswith(("_", "py.typed")) or path.name.endswith(".egg-info"):
                continue
            assert path.name in page or path.stem in page, f"{path.name} is not in the picture"

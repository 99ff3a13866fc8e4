import json
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.commands import call, sound

LOW_RATE = 8_000
"""Sounds of this rate take the least time."""


def library(folder: Path, count: int = 4, frames: int = 2_000) -> Path:
    folder.mkdir()
    for index in range(count):
        random = np.random.default_rng(index)
        samples = 0.2 * random.standard_normal((frames + 700 * index, 1))
        sound(folder / f"s{index:02d}.wav", samples.astype(np.float32), LOW_RATE)
    return folder


def results(out: Path) -> dict[str, bytes]:
    """Return the results in a folder, without records and lists: relative name and content."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.suffix not in (".json", ".jsonl")
    }


def record(out: Path, name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / f"{name}.json").read_text())
    return found


def rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def manifest(path: Path, *lines: object) -> Path:
    """Write a manifest of JSON lines; texts are written as they are."""
    texts = [line if isinstance(line, str) else json.dumps(line) for line in lines]
    path.write_text("".join(f"{text}\n" for text in texts))
    return path


def expected(local: Path, tmp_path: Path) -> dict[str, bytes]:
    assert call("catalogue", local, "--out", tmp_path / "local", "--workers", 1).code == 0
    return results(tmp_path / "local")

"""The texts and tables of tests/data, by their names there."""

import tomllib
from pathlib import Path
from typing import Any

DATA = Path(__file__).resolve().parents[1] / "data"


def text(name: str) -> str:
    return (DATA / name).read_bytes().decode()


def table(name: str) -> dict[str, Any]:
    return tomllib.loads(text(name))

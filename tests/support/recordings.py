"""Real recordings from outside the project: speech and event sounds of two Debian packages.

tools/fetch_recordings.sh puts them into .cache/recordings; the environment variable
CUSHION_RECORDINGS names another folder, relative to the project. Durations are in seconds.
"""

import functools
import os
from pathlib import Path

import pytest
import soundfile

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / os.environ.get("CUSHION_RECORDINGS", ".cache/recordings")
SHORTEST_S = 0.3
"""Shorter sounds are left out: they hold no more than a few windows of the transform."""

WHY_NONE = (
    f"no recordings in {FOLDER}: `make test` on Debian or Ubuntu, or tools/fetch_recordings.sh, "
    "fetches them"
)


@functools.cache
def recordings() -> list[Path]:
    """Sorted paths of all recordings longer than SHORTEST_S; empty where none were fetched."""
    files = sorted(path for path in FOLDER.rglob("*") if path.suffix in {".wav", ".oga"})
    return [path for path in files if soundfile.info(path).duration > SHORTEST_S]


def require_recordings() -> list[Path]:
    """`recordings()`, or the calling test skips and says how to get them."""
    found = recordings()
    if not found:
        pytest.skip(WHY_NONE)
    return found

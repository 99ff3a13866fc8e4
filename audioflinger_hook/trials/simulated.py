"""What simulated people of fits and studies share: their JSON file, and random answers."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.config.toml_text import text_of
from device.errors import UsageError
from device.units import FloatArray


def people_file(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file. UsageError: the file cannot be read, or has none."""
    try:
        found = json.loads(text_of(path, kind="JSON file"))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is no JSON ({error})") from None
    if not isinstance(found, dict):
        raise UsageError(f"{path} is not a JSON object")
    return found


def with_lapses(chances: FloatArray, lapse: float) -> FloatArray:
    """Return the chances of all answers if a share `lapse` of them is guessed."""
    return lapse / len(chances) + (1.0 - lapse) * chances


def drawn(chances: FloatArray, rng: np.random.Generator) -> int:
    """Return the index of a random answer. chances: of each answer, with the sum 1."""
    return int(np.searchsorted(np.cumsum(chances)[:-1], rng.random()))

"""Comparators: other ways from sound to vibration, in the project's own implementations.

    band_pass                  what is low in the sound, as it is
    envelope                   the sound's envelope, levelled, on a resonance
    centroid    -.             one sine at the spectral centroid
    octave_fold -'-- hops      two peaks, brought down by octaves

Each is one class of its module, made as `Way(samplerate, channels)`, and streams as the transform
does: see `stages.Comparator`. NumPy and SciPy, kept small; none is tuned.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

from tools.bench.baselines.stages import Comparator
from tools.bench.report import Missing
from tools.bench.workbench import Subject

__all__ = ["COMMAND", "NAMES", "load"]

NAMES = ("band-pass", "envelope", "centroid", "octave fold")
"""The name of each in the tables; its module has an underscore for what is no letter."""

COMMAND = "make run"
"""Installs the project with all of its parts."""


def load() -> tuple[tuple[Subject, ...], tuple[Missing, ...]]:
    """Return every comparator as a subject of the bench, and those that are not there."""
    found: list[Subject] = []
    missing: list[Missing] = []
    for name in NAMES:
        module = name.replace("-", "_").replace(" ", "_")
        try:
            way: Callable[[int, int], Comparator] = importlib.import_module(
                f"{__name__}.{module}"
            ).Way
        except (ImportError, AttributeError) as error:
            missing.append(Missing(f"every row of the comparator {name}", str(error), COMMAND))
        else:
            found.append(Subject(name, way))
    return tuple(found), tuple(missing)

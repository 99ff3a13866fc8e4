"""Other methods from sound to vibration, in our own small implementations; none is tuned.

    band_pass                  the low part of the sound, unchanged
    envelope                   the sound's envelope, levelled, on a resonance
    centroid    -.             one sine at the spectral centroid
    octave_fold -'-- hops      two peaks, brought down by octaves

Each is the class `Method` of its module, see `stages.Baseline`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

from tools.bench.baselines.stages import Baseline
from tools.bench.report import Missing
from tools.bench.workbench import Subject

__all__ = ["COMMAND", "NAMES", "load"]

NAMES = ("band-pass", "envelope", "centroid", "octave fold")
"""The name of each in the tables; its module has an underscore for what is no letter."""

COMMAND = "make run"
"""Installs the project with all of its parts."""


def load() -> tuple[tuple[Subject, ...], tuple[Missing, ...]]:
    """Return every baseline as a subject, and those that cannot be imported."""
    found: list[Subject] = []
    missing: list[Missing] = []
    for name in NAMES:
        module = name.replace("-", "_").replace(" ", "_")
        try:
            method: Callable[[int, int], Baseline]
            method = importlib.import_module(f"{__name__}.{module}").Method
        except (ImportError, AttributeError) as error:
            missing.append(Missing(f"every row of the baseline {name}", str(error), COMMAND))
        else:
            found.append(Subject(name, method))
    return tuple(found), tuple(missing)

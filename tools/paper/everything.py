"""Writes Figures 6, 7 and 8 of the paper to one folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from device.rig import PAPER
from tools.paper.felt import chosen_damping, felt, wanted_vibration
from tools.paper.figure6 import write_figure6
from tools.paper.figure7 import write_figure7
from tools.paper.figure8 import write_figure8
from tools.paper.recording import SAMPLERATE, recording
from tools.paper.response import measure_response
from tools.paper.units import unit_sequence


def write_figures(folder: Path) -> Iterator[Path]:
    """Write each figure's CSV and PNG to an existing folder, and yield their paths.

    Repeated calls write the same bytes. Errors: as for `AtomicFile`.
    """
    yield from write_figure6(measure_response(PAPER), folder)
    mono = recording().mean(axis=1, dtype=np.float64)
    yield from write_figure7(mono, SAMPLERATE, unit_sequence(mono, SAMPLERATE), folder)
    vibration = wanted_vibration(mono, SAMPLERATE)
    undamped = felt(vibration, PAPER, SAMPLERATE)
    yield from write_figure8(undamped, folder, "figure8")
    damped = felt(vibration, PAPER, SAMPLERATE, chosen_damping(PAPER))
    yield from write_figure8(damped, folder, "figure8_damped", undamped)

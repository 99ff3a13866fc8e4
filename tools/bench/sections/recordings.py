"""Bench on what is measured on: whether every recording is there and can be read."""

from __future__ import annotations

from tools.bench.report import Missing, Row, Section
from tools.bench.sounds.signals import KNOWN, RECORDINGS_COMMAND, SHORTEST_S
from tools.bench.workbench import Workbench

AGAIN = f"remove its folder, then {RECORDINGS_COMMAND}"


def recordings(bench: Workbench) -> Section:
    """How many recordings the rows on recordings are of, and which ones they lack."""
    title = "Recordings"
    explanation = (
        "Rows on recordings are of the speech of alsa-utils and the sounds of "
        f"sound-theme-freedesktop, {len(KNOWN)} files; those longer than {SHORTEST_S:g} s are "
        "used. Where one is missing such rows are of the others, and so not what they are "
        "elsewhere."
    )
    if not bench.recordings and not bench.absent:
        return Section(title, explanation, (), (bench.missing_recordings("recordings"),))
    return Section(
        title,
        explanation,
        (Row("recordings used", float(len(bench.recordings)), column="found"),),
        tuple(Missing(f"recording {name}", reason, AGAIN) for name, reason in bench.absent.items()),
    )

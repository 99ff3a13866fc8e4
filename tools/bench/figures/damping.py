"""The picture of residual vibration: what is left by how far f0 is off, for each way of driving.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tools.bench.report import BenchReport
from tools.bench.sections.damping import CHOSEN, CURVE, DETUNED_DB, EXACT_DB, TITLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 5.4
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 9.0, 14.0
LIMITED = 10.0
"""Percent of f0 up to which a limit is asked."""


def damping_figure(report: BenchReport) -> Figure:
    """Curves of residual energy over the true f0, named where they end, with the limits."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    series = report.section(TITLE).series
    reference, *others = series
    looks = {CHOSEN: (palette.FELT, 2.6)}
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(0.02, 0.95, "What is left when a burst ends", fontsize=TITLE_PT,
                color=palette.INK, va="center")  # fmt: skip
    figure.text(
        0.02, 0.90, "Energy of the seat's acceleration after 50 ms at 90 Hz, against undamped "
        "current drive at the same vibration, over the true f0", fontsize=SMALL_PT,
        color=palette.GREY, va="center",
    )  # fmt: skip
    axis = figure.subplots()
    figure.subplots_adjust(left=0.07, right=0.64, top=0.84, bottom=0.11)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.spines["bottom"].set_color(palette.HAIRLINE)
    axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)
    axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
    percent = 100.0 * np.array(CURVE)
    ends: list[tuple[float, str, str]] = []
    shades = (palette.HEARD_LIGHT, palette.HEARD)
    for name in others:
        strong = name.startswith("Bl 16")
        colour, width = looks.get(name, (shades[not name.startswith("current")], 1.6))
        colour = palette.FELT_LIGHT if strong else colour
        axis.plot(percent, series[name], color=colour, lw=width, ls="--" if strong else "-")
        ends.append((series[name][-1], name, colour))
    axis.axhline(0.0, color=palette.INK, lw=0.9)
    axis.text(0.0, 0.25, reference, fontsize=SMALL_PT, color=palette.INK, va="bottom", ha="center")
    axis.plot([-LIMITED, LIMITED], [DETUNED_DB.bound] * 2, color=palette.INK, lw=0.9,
              ls=(0, (4, 3)))  # fmt: skip
    axis.plot([0.0], [EXACT_DB.bound], marker="v", color=palette.INK, ms=6)
    axis.text(
        0.0, 0.015, "dashed line and triangle: what must be reached by “automatic”", va="bottom",
        fontsize=SMALL_PT, color=palette.GREY, transform=axis.transAxes,
    )  # fmt: skip
    _name_ends(axis, ends)
    axis.set_xlim(percent[0], percent[-1])
    axis.set_xticks(
        [-20, -10, -5, 0, 5, 10, 20], ["−20 %", "−10", "−5", "f0", "+5", "+10", "+20 %"]
    )
    low_db = min(min(levels) for levels in series.values())
    axis.set_ylim(bottom=low_db - 2.2)
    axis.set_ylabel("dB", rotation=0, fontsize=SMALL_PT, color=palette.GREY, loc="top", labelpad=-4)
    return figure


def _name_ends(axis: Axes, ends: list[tuple[float, str, str]]) -> None:
    """Write each curve's name beside its end, moved apart where they would touch."""
    from audioflinger_hook.figures import palette

    apart_db = 1.15
    place = -np.inf
    for level, name, colour in sorted(ends):
        place = max(level, place + apart_db)
        axis.annotate(
            name, (20.0, level), xytext=(22.5, place), textcoords="data", fontsize=SMALL_PT,
            color=palette.INK, va="center", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 1.2, "shrinkA": 1, "shrinkB": 0,
                        "relpos": (0.0, 0.5)},
        )  # fmt: skip

"""Shared parts of the paper's figures: a sheet with a title and stacked panels, and PNG output.

This module uses neither pyplot nor global settings of matplotlib.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from audioflinger_hook.figures import palette, panels
from device.atomic_file import write_bytes_atomically

DPI = 150
WIDTH_IN = 10.0
LEFT, RIGHT = 0.085, 0.93
TITLE_PT = 14.0
TOP_IN = 1.08
LINE_IN = 0.18
NARROW_IN, WIDE_IN, LAST_IN = 0.42, 0.85, 0.55
"""Space in inches below a panel without a label, a panel with a label, and the last panel."""


def sheet(
    title: str, explanation: str, panels_in: Sequence[tuple[float, float]]
) -> tuple[Figure, list[Axes]]:
    """Return a figure 10 inches wide with empty panels, from top to bottom.

    explanation: one or two lines. panels_in: height of each panel and space below it, in inches.
    """
    top_in = TOP_IN + LINE_IN * explanation.count("\n")
    height_in = top_in + sum(map(sum, panels_in))
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, facecolor=palette.WHITE)
    FigureCanvasAgg(figure)
    figure.text(
        LEFT, 1.0 - 0.33 / height_in, title, fontsize=TITLE_PT, fontfamily=panels.FONT,
        fontweight="bold", color=palette.INK, va="center",
    )  # fmt: skip
    figure.text(
        LEFT, 1.0 - 0.52 / height_in, explanation, fontsize=panels.TICK_PT, color=palette.GREY,
        fontfamily=panels.FONT, va="top", linespacing=1.35,
    )  # fmt: skip
    axes, used_in = [], top_in
    for panel_in, below_in in panels_in:
        used_in += panel_in
        place = (LEFT, 1.0 - used_in / height_in, RIGHT - LEFT, panel_in / height_in)
        axes.append(figure.add_axes(place))
        panels.style_axes(axes[-1])
        used_in += below_in
    return figure, axes


def label_horizontal(axes: Axes, label: str) -> None:
    """Label the horizontal axis; `label` includes the unit."""
    axes.set_xlabel(
        label, fontsize=panels.LABEL_PT, fontfamily=panels.FONT, color=palette.INK, labelpad=3
    )


def colour_bar(figure: Figure, axes: Axes, image: AxesImage, unit: str) -> Colorbar:
    """Add a narrow colour bar in the right margin, so that all panels have the same width."""
    bar_axes = axes.inset_axes((1.008, 0.0, 0.0075, 1.0))
    bar = figure.colorbar(image, cax=bar_axes)
    for line in bar_axes.spines.values():
        line.set_visible(False)
    bar_axes.tick_params(labelsize=panels.TICK_PT - 0.5, labelcolor=palette.GREY, length=0.0, pad=3)
    bar_axes.annotate(
        unit, (0.0, 1.0), (0.0, 7.0), xycoords="axes fraction", textcoords="offset points",
        fontsize=panels.TICK_PT - 0.5, fontfamily=panels.FONT, color=palette.GREY, va="baseline",
    )  # fmt: skip
    return bar


def save(figure: Figure, path: Path) -> None:
    """Write the figure to a PNG atomically. Errors: as for `AtomicFile`."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    write_bytes_atomically(path, content.getvalue())

"""Functions that draw the common parts of all pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from audioflinger_hook.figures import palette

WIDTH_IN = 10.0
TEXT_PT, TITLE_PT, SMALL_PT = 10.0, 14.0, 9.0
LINE_IN = 0.25
DASHES: Any = (0, (4, 3))
LETTER_PT, LINE_PT = 4.4, 10.0  # width of a letter and height of a line of small labels, in points

Point = tuple[float, float]


def sheet(title: str, explanation: str, height_in: float) -> Figure:
    """Return an empty figure, 10 inches wide, with a title and an explanation."""
    figure = Figure(figsize=(WIDTH_IN, height_in), facecolor=palette.WHITE)
    top = 1.0 - LINE_IN / height_in
    below = top - LINE_IN / height_in
    figure.text(0.02, top, title, fontsize=TITLE_PT, color=palette.INK, va="center")
    figure.text(0.02, below, explanation, fontsize=SMALL_PT, color=palette.GREY, va="center")
    return figure


def frame(axis: Axes, title: str = "", *, grid: bool = False, unit: str = "") -> None:
    """Style an axis: show only the bottom spine, the title and the unit of x."""
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.spines["bottom"].set_color(palette.HAIRLINE)
    axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)
    axis.tick_params(which="minor", length=0)
    if grid:
        axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
    if title:
        axis.set_title(title, fontsize=TEXT_PT, color=palette.INK)
    if unit:
        axis.set_xlabel(unit, fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)


def legend(figure: Figure, left: float, entries: Sequence[tuple[str, str, str]]) -> None:
    """Write the legend in a line below the explanation.

    left: start of the line relative to the figure's width.
    entries: mark, colour and name of each entry.
    """
    height = 1.0 - 3.0 * LINE_IN / figure.get_figheight()
    for mark, colour, name in entries:
        figure.text(left, height, mark, color=colour, fontsize=TEXT_PT + 2, va="center")
        at = left + 0.013 * len(mark) + 0.006
        figure.text(at, height, name, color=palette.INK, fontsize=TEXT_PT, va="center")
        left = at + 0.0088 * len(name) + 0.03


def limit(axis: Axes, x: float) -> None:
    """Draw a dashed vertical line that marks a limit."""
    axis.axvline(x, color=palette.INK, lw=0.9, ls=DASHES, zorder=1)


def ticks_at(axis: Axes, places: Sequence[float], low: float, high: float) -> None:
    """Label a logarithmic x-axis at the `places` between `low` and `high`."""
    inside = [place for place in places if low <= place <= high]
    axis.set_xticks(inside, [f"{place:g}" for place in inside])


def note(axis: Axes, text: str, at: Point, **options: Any) -> None:
    """Write a small grey text at a position relative to the axes."""
    axis.text(*at, text, fontsize=SMALL_PT, color=palette.GREY, transform=axis.transAxes,
              va="bottom", **options)  # fmt: skip


def number_beside(axis: Axes, text: str, at: Point, *, left: bool = False) -> None:
    """Write a number to the right or left of a point."""
    axis.annotate(
        text, at, xytext=(-6 if left else 6, 0), textcoords="offset points", zorder=4,
        ha="right" if left else "left", va="center_baseline", fontsize=SMALL_PT - 0.5,
        color=palette.GREY, bbox={"facecolor": palette.WHITE, "edgecolor": "none", "pad": 0.4},
    )  # fmt: skip


def name_ends(axis: Axes, ends: Sequence[tuple[float, str, str]], x: float, apart: float) -> None:
    """Label the right ends of curves.

    ends: final y value, name and colour of each curve.
    x: x value at which the curves end.
    apart: smallest allowed vertical distance between labels, in units of y.
    """
    height = -np.inf
    width = float(np.diff(axis.get_xlim())[0])
    for level, name, colour in sorted(ends):
        height = max(level, height + apart)
        axis.annotate(
            name, (x, level), xytext=(x + 0.06 * width, height), textcoords="data",
            fontsize=SMALL_PT, color=palette.INK, va="center", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 1.2, "shrinkA": 1, "shrinkB": 0,
                        "relpos": (0.0, 0.5)},
        )  # fmt: skip


def name_points(axis: Axes, names: Sequence[tuple[str, Point]]) -> None:
    """Write names to the right of points; names that would overlap are moved up."""
    to_points = 72.0 / axis.figure.dpi
    taken: list[tuple[float, float, float]] = []
    for name, point in sorted(names, key=lambda each: each[1][1]):
        x, y = np.asarray(axis.transData.transform(point)) * to_points
        end = x + 6.0 + LETTER_PT * len(name)
        height = y
        for left, right, other in taken:
            if left < end and x < right and abs(other - height) < LINE_PT:
                height = other + LINE_PT
        taken.append((x, end, height))
        line = {"arrowstyle": "-", "color": palette.GREY, "lw": 0.6, "shrinkB": 2.0}
        axis.annotate(
            name, point, xytext=(6.0, height - y), textcoords="offset points", va="center",
            fontsize=7.5, color=palette.GREY, zorder=6,
            arrowprops=line if height - y >= LINE_PT else None,
        )  # fmt: skip

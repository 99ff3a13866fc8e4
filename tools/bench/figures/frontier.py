"""The picture of the frontier: what each setting of the live form costs, and what error it leaves.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tools.bench.report import BenchReport
from tools.bench.sections.frontier import BLUR, CHIRP, COST, LEAK, PURITY, SWELL, TITLE, UNITS
from tools.bench.sections.frontier_settings import DEFAULT, SETTINGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 7.2
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 9.0, 14.0
LABEL_PT, LETTER_PT, LINE_PT = 7.5, 4.4, 10.0
"""A label's size, and about how wide a letter of it and how high a line is."""
ERRORS = {
    CHIRP: "error on a chirp",
    SWELL: "error of a swelling level",
    LEAK: "energy over 250 Hz",
    PURITY: "worst THD+N of a tone",
}
STEP_PT = 3.0
"""Of points along a line that names must not cover."""
COST_TICKS_MS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)

Box = tuple[float, float, float, float]
"""Left, bottom, right, top; points."""


def frontier_figure(report: BenchReport) -> Figure:
    """Four errors over cost: hops joined by a line, other settings as points, defaults marked."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    values = {(row.name, row.column): row.value for row in report.section(TITLE).rows}
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(0.02, 0.962, "What an error costs", fontsize=TITLE_PT, color=palette.INK,
                va="center")  # fmt: skip
    figure.text(
        0.02, 0.922, "Errors of the live form over what a second of stereo costs in ms, one "
        "setting changed at a time; lower is better",
        fontsize=SMALL_PT, color=palette.GREY, va="center",
    )  # fmt: skip
    axes = figure.subplots(2, 2, sharex=True).ravel()
    figure.subplots_adjust(left=0.06, right=0.98, top=0.83, bottom=0.065, wspace=0.13, hspace=0.19)
    for axis, (column, title) in zip(axes, ERRORS.items(), strict=True):
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.spines["bottom"].set_color(palette.HAIRLINE)
        axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
        axis.set_title(f"{title}, {UNITS[column]}", fontsize=TEXT_PT, color=palette.INK)
        _draw_error(axis, column, values)
        axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)
        axis.tick_params(axis="x", which="minor", length=0)
    axes[-1].set_xlabel("ms", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)
    for x, colour, name in (
        (0.06, palette.FELT, "the defaults"),
        (0.20, palette.HEARD, "another hop"),
        (0.34, palette.GREY, "another setting; named where the error differs"),
    ):
        figure.text(x, 0.885, "●", color=colour, fontsize=TEXT_PT + 2, va="center")
        figure.text(x + 0.019, 0.885, name, color=palette.INK, fontsize=TEXT_PT, va="center")
    return figure


def _draw_error(axis: Axes, column: str, values: dict[tuple[str, str], float | None]) -> None:
    """Draw one error of all settings over their cost."""
    from audioflinger_hook.figures import palette

    points: dict[str, tuple[float, float]] = {}
    for setting in SETTINGS:
        cost, error = (values[setting.name, f"{name}, {UNITS[name]}"] for name in (COST, column))
        if cost is not None and error is not None:
            points[setting.name] = cost, error
    hops = [points[s.name] for s in SETTINGS if s.knob in ("", "hop") and s.name in points]
    axis.set_xscale("log")
    axis.plot(*zip(*sorted(hops), strict=True), color=palette.HEARD, lw=1.4, zorder=3)
    for setting in SETTINGS:
        if setting.name in points:
            default = setting.name == DEFAULT
            colour = palette.HEARD if setting.knob == "hop" else palette.GREY
            axis.plot(
                *([place] for place in points[setting.name]), "o", ms=9 if default else 4.5,
                color=palette.FELT if default else colour, zorder=5 if default else 4,
            )  # fmt: skip
    axis.margins(0.09, 0.2)
    low, high = axis.get_xlim()
    ticks = [tick for tick in COST_TICKS_MS if low <= tick <= high]
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    error = points[DEFAULT][1]
    named = [
        (name.replace("low-pass of ", ""), place)
        for name, place in points.items()
        if abs(place[1] - error) > BLUR[column]
    ]
    _name_points(axis, list(points.values()), sorted(hops), named)


def _name_points(
    axis: Axes,
    points: Sequence[tuple[float, float]],
    line: Sequence[tuple[float, float]],
    named: Sequence[tuple[str, tuple[float, float]]],
) -> None:
    """Write names beside points, each where it covers no point, no line and no other name."""
    from audioflinger_hook.figures import palette

    to_points = 72.0 / axis.figure.dpi

    def place(point: tuple[float, float]) -> tuple[float, float]:
        x, y = axis.transData.transform(point)
        return float(x) * to_points, float(y) * to_points

    xs, ys = zip(*map(place, line), strict=True)
    along = np.arange(xs[0], xs[-1], STEP_PT)
    drawn = [(float(x), float(y)) for x, y in zip(along, np.interp(along, xs, ys), strict=True)]
    taken: list[Box] = [
        (x - room, y - room, x + room, y + room)
        for some, room in ((map(place, points), 3.0), (drawn, 1.0))
        for x, y in some
    ]
    field = axis.get_window_extent()
    left_end, right_end, low_end, high_end = (
        float(end) * to_points for end in (field.x0, field.x1, field.y0, field.y1)
    )
    for name, point in named:
        x, y = place(point)
        width = LETTER_PT * len(name)
        boxes = [
            (left, y + dy - LINE_PT / 2.0, left + width, y + dy + LINE_PT / 2.0)
            for dy in (0.0, 6.0, -6.0, 12.0, -12.0, 18.0, -18.0, 26.0, -26.0, 34.0, -34.0)
            for left in (x + 6.0, x - 6.0 - width, x - width / 2.0)
        ]
        inside = [
            box
            for box in boxes
            if left_end < box[0]
            and box[2] < right_end + 4.0
            and low_end < box[1]
            and box[3] < high_end
        ]
        left, bottom, *_ = box = min(
            inside or boxes,
            key=lambda box: _covered(box, taken) + abs(box[1] + LINE_PT / 2.0 - y),
        )
        taken.append(box)
        axis.annotate(
            name, point, xytext=(left - x, bottom + LINE_PT / 2.0 - y),
            textcoords="offset points", fontsize=LABEL_PT, color=palette.GREY, va="center",
            zorder=6, arrowprops=_leader(bottom + LINE_PT / 2.0 - y, palette.GREY),
        )  # fmt: skip


def _leader(away_pt: float, colour: str) -> dict[str, object] | None:
    """Return how a name that stands higher or lower than its point is led to it."""
    if abs(away_pt) < LINE_PT:
        return None
    return {"arrowstyle": "-", "color": colour, "lw": 0.6, "shrinkA": 1.0, "shrinkB": 2.0}


def _covered(box: Box, others: Sequence[Box]) -> float:
    """Return how much of other boxes one covers, in square points."""
    return sum(
        max(0.0, min(box[2], other[2]) - max(box[0], other[0]))
        * max(0.0, min(box[3], other[3]) - max(box[1], other[1]))
        for other in others
    )

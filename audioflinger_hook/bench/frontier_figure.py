"""The picture of the frontier: what each setting of the live form costs, and what error it leaves.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from audioflinger_hook.bench.frontier import (
    COST,
    LAG,
    LEAK,
    SWELL,
    TITLE,
    UNITS,
)
from audioflinger_hook.bench.frontier_settings import DEFAULT, SETTINGS
from audioflinger_hook.bench.report import BenchReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 4.8
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 8.0, 14.0
ERRORS = {LAG: "onset lag, p95", SWELL: "error of a swelling level", LEAK: "energy over 250 Hz"}


def frontier_figure(report: BenchReport) -> Figure:
    """Three errors over cost: hops joined by a line, other settings as points, defaults marked."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    values = {(row.name, row.column): row.value for row in report.section(TITLE).rows}
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(0.02, 0.945, "What an error costs", fontsize=TITLE_PT, color=palette.INK,
                va="center")  # fmt: skip
    figure.text(
        0.02, 0.885, "Errors of the live form over what a second of stereo costs in ms, one "
        "setting changed at a time: the hop along the line, all else as points; lower is better",
        fontsize=SMALL_PT + 1.0, color=palette.GREY, va="center",
    )  # fmt: skip
    axes = figure.subplots(1, len(ERRORS))
    figure.subplots_adjust(left=0.05, right=0.985, top=0.77, bottom=0.13, wspace=0.17)
    for axis, (column, title) in zip(axes, ERRORS.items(), strict=True):
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.spines["bottom"].set_color(palette.HAIRLINE)
        axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)
        axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
        axis.set_title(f"{title}, {UNITS[column]}", fontsize=TEXT_PT, color=palette.INK)
        hops: list[tuple[float, float]] = []
        for setting in SETTINGS:
            cost, error = (
                values[setting.name, f"{name}, {UNITS[name]}"] for name in (COST, column)
            )
            if cost is None or error is None:
                continue
            if setting.knob in ("", "hop"):
                hops.append((cost, error))
            if setting.name == DEFAULT:
                axis.plot([cost], [error], "o", ms=9, color=palette.FELT, zorder=5)
            else:
                colour = palette.HEARD if setting.knob == "hop" else palette.GREY
                axis.plot([cost], [error], "o", ms=4, color=colour, zorder=4)
            if setting.knob in ("hop", "window"):
                axis.annotate(
                    setting.name, (cost, error), xytext=(4, 4), textcoords="offset points",
                    fontsize=SMALL_PT - 1.0, color=palette.GREY,
                )  # fmt: skip
        axis.plot(*zip(*sorted(hops), strict=True), color=palette.HEARD, lw=1.4, zorder=3)
        axis.margins(0.2, 0.1)
    axes[-1].set_xlabel("ms", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)
    figure.text(0.86, 0.945, "●", color=palette.FELT, fontsize=TEXT_PT + 2, va="center")
    figure.text(0.88, 0.945, "the defaults", color=palette.INK, fontsize=TEXT_PT, va="center")
    return figure

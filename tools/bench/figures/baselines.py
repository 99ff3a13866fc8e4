"""The picture of the comparators: what each way from sound to vibration costs, and what is felt.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tools.bench.report import BenchReport, number
from tools.bench.sections.baselines import (
    BURSTS_FELT,
    CORRELATION,
    COST_FFTS,
    FELT_DB,
    LAG_P95,
    LEAK_MEDIAN,
    TITLE,
)
from tools.bench.workbench import LIVE, REFERENCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 4.6
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 8.5, 14.0
FIELDS = {
    COST_FFTS: "cost of a second,\nrfft(2048); log scale",
    LAG_P95: "onset lag, 95 %,\nof bursts felt, ms",
    BURSTS_FELT: "bursts felt {played},\n80 to 5000 Hz",
    LEAK_MEDIAN: "energy above 250 Hz,\nmedian recording, dB",
    CORRELATION: "envelope correlation,\nmedian recording",
}

MORE = (BURSTS_FELT, CORRELATION)
"""Of these more is better, of the others less."""


def comparison_figure(report: BenchReport) -> Figure:
    """A line for each way, the live form first, and a field of points for each measure."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    shown = report.section(TITLE).rows
    rows = {(row.name, row.column): row.value for row in shown}
    played = next((row.unit for row in shown if row.name == BURSTS_FELT), "")  # "of 30"
    ways = list(dict.fromkeys(column for name, column in rows if name == BURSTS_FELT))
    fields = {name: title for name, title in FIELDS.items() if (name, LIVE) in rows}
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(0.02, 0.94, "Other ways from sound to vibration", fontsize=TITLE_PT,
                color=palette.INK, va="center")  # fmt: skip
    figure.text(
        0.02, 0.88, "The same sounds through each; implementations of our own, not tuned. Lags "
        f"are of the bursts felt, over {FELT_DB:g} dB; what stays silent has none",
        fontsize=SMALL_PT, color=palette.GREY, va="center",
    )  # fmt: skip
    axes = figure.subplots(1, len(fields), sharey=True)
    figure.subplots_adjust(left=0.105, right=0.985, top=0.69, bottom=0.05, wspace=0.12)
    for axis, (name, title) in zip(axes, fields.items(), strict=True):
        title = f"{title.format(played=played)}\n{'better →' if name in MORE else '← better'}"
        axis.set_title(title, fontsize=SMALL_PT, color=palette.INK, linespacing=1.3)
        _draw_measure(axis, [rows.get((name, way)) for way in ways], ways, name == COST_FFTS)
    axes[0].set_yticks(range(len(ways)), ways, fontsize=TEXT_PT, color=palette.INK)
    axes[0].set_ylim(len(ways) - 0.5, -0.5)
    return figure


def _draw_measure(axis: Axes, values: list[float | None], ways: list[str], log: bool) -> None:
    """Draw one measure of all ways, each with its number."""
    from audioflinger_hook.figures import palette

    colours = {LIVE: palette.FELT, REFERENCE: palette.HEARD}
    there = [value for value in values if value is not None]
    if log:
        axis.set_xscale("log")
        low, high = min(there) / 2.5, max(there) * 12.0
    else:
        span = max(there) - min(min(there), 0.0)
        low, high = min(*there, 0.0) - 0.06 * span, max(*there, 0.0) + 0.5 * span
    axis.set_xlim(low, high)
    for line, (way, value) in enumerate(zip(ways, values, strict=True)):
        axis.axhline(line, color=palette.HAIRLINE, lw=0.8, zorder=1)
        if value is None:
            continue
        colour = colours.get(way, palette.GREY)
        axis.plot([value], [line], "o", ms=7, color=colour, zorder=3)
        axis.annotate(
            number(value), (value, line), xytext=(7, 0), textcoords="offset points",
            fontsize=SMALL_PT, color=palette.INK, va="center_baseline", zorder=4,
            bbox={"facecolor": palette.WHITE, "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip
    for side in ("top", "right", "left", "bottom"):
        axis.spines[side].set_visible(False)
    axis.tick_params(length=0)
    axis.tick_params(axis="x", which="both", length=0, labelbottom=False)

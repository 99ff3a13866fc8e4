"""A picture that compares methods by CPU time, onset lag, bursts perceived and similarity."""

from __future__ import annotations

from matplotlib.figure import Figure

from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import SMALL_PT, TEXT_PT, frame, number_beside, sheet
from tools.bench.report import BenchReport, number
from tools.bench.sections.comparison import (
    BURSTS_FELT,
    CORRELATION,
    COST,
    FELT_DB,
    FFTS,
    LAG_P95,
    LEAK_MEDIAN,
)
from tools.bench.workbench import LIVE, REFERENCE

FIELDS = {
    COST + FFTS: "cost of a second,\nrfft(2048); log scale",
    LAG_P95: "onset lag, 95 %,\nof bursts perceived, ms",
    BURSTS_FELT: "bursts perceived {played},\n80 to 5000 Hz",
    LEAK_MEDIAN: "energy above 250 Hz,\nmedian recording, dB",
    CORRELATION: "envelope correlation,\nmedian recording",
}
MORE = (BURSTS_FELT, CORRELATION)  # measures for which larger values are better


def baselines(report: BenchReport) -> Figure:
    """Draw a panel for each measured quantity, with a horizontal line for each method."""
    shown = report.section("Baselines").rows
    rows = {(row.name, row.column): row.value for row in shown}
    played = next((row.unit for row in shown if row.name == BURSTS_FELT), "")
    names = list(dict.fromkeys(column for name, column in rows if name == BURSTS_FELT))
    fields = {name: title for name, title in FIELDS.items() if (name, LIVE) in rows}
    figure = sheet(
        "Other methods on the same sounds",
        "Plain implementations, not tuned. Lags are of the bursts perceived, over "
        f"{FELT_DB:g} dB; a method that stays silent has none",
        4.6,
    )
    axes = figure.subplots(1, len(fields), sharey=True)
    figure.subplots_adjust(left=0.105, right=0.985, top=0.70, bottom=0.05, wspace=0.12)
    colours = {LIVE: palette.FELT, REFERENCE: palette.HEARD}
    for axis, (name, title) in zip(axes, fields.items(), strict=True):
        frame(axis)
        axis.spines["bottom"].set_visible(False)
        better = "better →" if name in MORE else "← better"
        axis.set_title(f"{title.format(played=played)}\n{better}", fontsize=SMALL_PT - 0.5)
        there = {column: value for (row, column), value in rows.items()
                 if row == name and value is not None and column in names}  # fmt: skip
        low, high = min(there.values()), max(there.values())
        if name == COST + FFTS:
            axis.set_xscale("log")
            axis.set_xlim(low / 2.5, high * 12.0)
        else:
            low, high = min(low, 0.0), max(high, 0.0)
            axis.set_xlim(low - 0.06 * (high - low), high + 0.5 * (high - low))
        for line, column in enumerate(names):
            axis.axhline(line, color=palette.HAIRLINE, lw=0.8, zorder=1)
            if column in there:
                colour = colours.get(column, palette.GREY)
                axis.plot([there[column]], [line], "o", ms=7, color=colour, zorder=3)
                number_beside(axis, number(there[column]), (there[column], line))
        axis.tick_params(axis="both", which="both", length=0, labelbottom=False)
    axes[0].set_yticks(range(len(names)), names, fontsize=TEXT_PT, color=palette.INK)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    return figure

"""A picture of CPU time and errors of the transform's live form with different settings."""

from __future__ import annotations

from matplotlib.figure import Figure

from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import frame, legend, name_points, sheet, ticks_at
from tools.bench.report import BenchReport
from tools.bench.sections.frontier import BLUR, CHIRP, COST, LEAK, PURITY, SWELL, TITLE, UNITS
from tools.bench.sections.frontier_settings import DEFAULT, SETTINGS

ERRORS = {
    CHIRP: "error on a chirp",
    SWELL: "error of a swelling level",
    LEAK: "energy over 250 Hz",
    PURITY: "worst THD+N of a tone",
}
TICKS_MS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)


def frontier(report: BenchReport) -> Figure:
    """Draw four errors over CPU time. A line joins the settings that differ only in hop size."""
    values = {(row.name, row.column): row.value for row in report.section(TITLE).rows}
    figure = sheet(
        "What an error costs",
        "Errors of the live form over what a second of stereo costs in ms, one setting changed "
        "at a time; lower is better",
        7.2,
    )
    legend(figure, 0.06, [("●", palette.FELT, "the defaults"), ("●", palette.HEARD, "another hop"),
           ("●", palette.GREY, "another setting; named where the error differs")])  # fmt: skip
    axes = figure.subplots(2, 2, sharex=True).ravel()
    figure.subplots_adjust(left=0.06, right=0.98, top=0.85, bottom=0.065, wspace=0.13, hspace=0.19)
    for axis, (column, title) in zip(axes, ERRORS.items(), strict=True):
        points: dict[str, tuple[float, float]] = {}
        for setting in SETTINGS:
            cost, error = (values[setting.name, f"{c}, {UNITS[c]}"] for c in (COST, column))
            points[setting.name] = cost or 0.0, error or 0.0
        hops = [points[s.name] for s in SETTINGS if s.knob in ("", "hop")]
        axis.set_xscale("log")
        frame(axis, f"{title}, {UNITS[column]}", grid=True)
        axis.plot(*zip(*sorted(hops), strict=True), color=palette.HEARD, lw=1.4, zorder=3)
        for setting in SETTINGS:
            colour = palette.HEARD if setting.knob == "hop" else palette.GREY
            default = setting.name == DEFAULT
            axis.plot(
                *([place] for place in points[setting.name]), "o", ms=9 if default else 4.5,
                color=palette.FELT if default else colour, zorder=5 if default else 4,
            )  # fmt: skip
        axis.margins(0.16, 0.2)
        ticks_at(axis, TICKS_MS, *axis.get_xlim())
        named = [
            (name.replace("low-pass of ", ""), place)
            for name, place in points.items()
            if abs(place[1] - points[DEFAULT][1]) > BLUR[column]
        ]
        name_points(axis, named)
    axes[-1].tick_params(axis="x", which="minor", length=0)
    frame(axes[-1], unit="ms", grid=True)
    return figure

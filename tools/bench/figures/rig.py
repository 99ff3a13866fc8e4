"""Pictures of the simulated rig: errors of its models over CPU time, and residual vibration."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import DASHES, SMALL_PT, frame, name_ends, note, sheet
from tools.bench.report import BenchReport
from tools.bench.sections.damping import CHOSEN, CURVE, DETUNED_DB, EXACT_DB, TITLE

CURVE_MARKERS, POINT_MARKERS = "osD^v<", "*PXp"
TONES = (palette.INK, palette.HEARD, palette.GREY, palette.HEARD_LIGHT)
LIMITED_PERCENT = 10.0  # largest detuning in percent for which a limit applies
APART_DB = 1.15


def models(report: BenchReport) -> Figure:
    """Draw the errors of the rig's models and of SciPy's integrators over their CPU time."""
    figure = sheet(
        "What an error of the simulated motion costs",
        "Non-linear equations, driven to nine tenths of Xmax: largest error of the displacement "
        "over its peak, by CPU time for a second of signal",
        4.4,
    )
    axis = figure.subplots()
    figure.subplots_adjust(left=0.085, right=0.725, top=0.80, bottom=0.125)
    axis.set_xscale("log")
    axis.set_yscale("log")
    frame(axis, grid=True, unit="CPU time, ms")
    curves = points = 0
    for name, values in report.section("Work and precision").series.items():
        costs_ms, errors = 1e3 * np.array(values[::2]), np.array(values[1::2])
        if len(costs_ms) == 1:
            look = {"marker": POINT_MARKERS[points % len(POINT_MARKERS)], "ls": "none", "ms": 7,
                    "color": palette.INK if name == "lsim" else palette.FELT}  # fmt: skip
            points += 1
        else:
            look = {"marker": CURVE_MARKERS[curves % len(CURVE_MARKERS)], "ms": 5.5,
                    "lw": 1.2 if curves else 2.2,
                    "color": TONES[(curves - 1) % 4] if curves else palette.FELT}  # fmt: skip
            curves += 1
        axis.plot(costs_ms, errors, label=name, zorder=3, **look)  # type: ignore[arg-type]
    axis.legend(
        loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, fontsize=SMALL_PT,
        labelcolor=palette.INK, labelspacing=0.9, handlelength=2.2,
    )  # fmt: skip
    axis.set_title("error over peak", loc="left", fontsize=SMALL_PT, color=palette.GREY, x=-0.06)
    return figure


def damping(report: BenchReport) -> Figure:
    """Draw residual vibration over the deviation of the resonance frequency, by kind of drive."""
    reference, *others = (series := report.section(TITLE).series)
    figure = sheet(
        "What is left when a burst ends",
        "Energy of the seat's acceleration after 50 ms at 90 Hz, against undamped current drive "
        "at the same vibration, over the true f0",
        5.4,
    )
    axis = figure.subplots()
    figure.subplots_adjust(left=0.07, right=0.64, top=0.86, bottom=0.11)
    frame(axis, grid=True)
    percent = 100.0 * np.array(CURVE)
    axis.set_xlim(percent[0], percent[-1])
    ends: list[tuple[float, str, str]] = []
    for name in others:
        strong, chosen = name.startswith("Bl 16"), name == CHOSEN
        colour = palette.HEARD_LIGHT if name.startswith("current") else palette.HEARD
        colour = palette.FELT_LIGHT if strong else palette.FELT if chosen else colour
        axis.plot(percent, series[name], color=colour, lw=2.6 if chosen else 1.6,
                  ls="--" if strong else "-")  # fmt: skip
        ends.append((series[name][-1], name, colour))
    axis.axhline(0.0, color=palette.INK, lw=0.9)
    axis.text(0.0, 0.25, reference, fontsize=SMALL_PT, color=palette.INK, va="bottom", ha="center")
    limited = [-LIMITED_PERCENT, LIMITED_PERCENT]
    axis.plot(limited, [DETUNED_DB.bound] * 2, color=palette.INK, lw=0.9, ls=DASHES)
    axis.plot([0.0], [EXACT_DB.bound], marker="v", color=palette.INK, ms=6)
    note(axis, "dashed line and triangle: the limits of “automatic”", (0.2, 0.015))
    axis.set_xticks([-20, -10, -5, 0, 5, 10, 20], ["−20 %", "−10", "−5", "f0", "+5", "+10", "+20"])
    axis.set_ylim(bottom=min(min(levels) for levels in series.values()) - 2.2)
    axis.set_ylabel("dB", rotation=0, fontsize=SMALL_PT, color=palette.GREY, loc="top", labelpad=-4)
    name_ends(axis, ends, percent[-1], APART_DB)
    return figure

"""Pictures that compare: baselines, levels by profile, speech with and without suppression."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import SMALL_PT, TEXT_PT, frame, legend, limit, number_beside, sheet
from tools.bench.report import BenchReport, number
from tools.bench.sections.comparison import (
    BURSTS_FELT,
    CORRELATION,
    COST_FFTS,
    FELT_DB,
    LAG_P95,
    LEAK_MEDIAN,
)
from tools.bench.sections.levels import CONTRAST, SILENT, ways
from tools.bench.sections.speech_suppression import (
    COURSE_S,
    EFFECT_AT_S,
    LEAST_DB,
    SUPPRESSION_DB,
)
from tools.bench.workbench import LIVE, REFERENCE

FIELDS = {
    COST_FFTS: "cost of a second,\nrfft(2048); log scale",
    LAG_P95: "onset lag, 95 %,\nof bursts felt, ms",
    BURSTS_FELT: "bursts felt {played},\n80 to 5000 Hz",
    LEAK_MEDIAN: "energy above 250 Hz,\nmedian recording, dB",
    CORRELATION: "envelope correlation,\nmedian recording",
}
MORE = (BURSTS_FELT, CORRELATION)
"""Of these more is better, of the others less."""
LOUDEST, LOW = ", loudest tenth", ", -20 dB"
PITCH = 0.15


def baselines(report: BenchReport) -> Figure:
    """Draw a line for each baseline, the live form first, and a field for each measure."""
    shown = report.section("Baselines").rows
    rows = {(row.name, row.column): row.value for row in shown}
    played = next((row.unit for row in shown if row.name == BURSTS_FELT), "")
    names = list(dict.fromkeys(column for name, column in rows if name == BURSTS_FELT))
    fields = {name: title for name, title in FIELDS.items() if (name, LIVE) in rows}
    figure = sheet(
        "Other methods on the same sounds",
        "Implementations of our own, not tuned. Lags are of the bursts felt, over "
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
        if name == COST_FFTS:
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


def levels(report: BenchReport) -> Figure:
    """Draw each sound's level at two volumes by profile, then two measures as bars."""
    values = {(row.name, row.column): row.value for row in report.section("Level").rows}
    names = [way.name for way in ways()]
    shades = (palette.HEARD, palette.HEARD_LIGHT, palette.FELT, palette.FELT_LIGHT, palette.INK)
    colours = dict(zip(names, shades, strict=True))
    sounds = [
        name.removesuffix(LOUDEST)
        for name, column in values
        if column == "in" and name.endswith(LOUDEST)
    ]
    figure = sheet(
        "How strong a sound is felt",
        "Left: the loudest tenth of the units; dot: at full volume, end of the line: played 20 dB "
        "lower. Right: how far an explosion stands above speech; units not felt",
        5.0,
    )
    legend(figure, 0.115, [*(("●", colour, name) for name, colour in colours.items()),
           ("▮", palette.HAIRLINE, "the sound itself")])  # fmt: skip
    wide, contrast, silence = figure.subplots(1, 3, width_ratios=(3.0, 1.2, 1.2))
    figure.subplots_adjust(left=0.115, right=0.985, top=0.77, bottom=0.09, wspace=0.28)
    frame(wide, unit="dB of full scale")
    frame(contrast, "explosion over speech, dB")
    frame(silence, "not felt at -20 dB, %")
    for line, sound in enumerate(sounds):
        title = f"{sound}{LOUDEST}"
        for mark in (values[title, "in"], values[title + LOW, "in"]):
            wide.plot([mark, mark], [line - 0.36, line + 0.36], color=palette.HAIRLINE, lw=3.0)
        for place, name in enumerate(names):
            height = line + (place - 2) * PITCH
            full, low = values[title, name], values[title + LOW, name]
            wide.plot([low, full], [height, height], color=colours[name], lw=1.6)
            wide.plot([full], [height], "o", ms=5, color=colours[name])
    wide.set_yticks(range(len(sounds)), sounds, fontsize=TEXT_PT, color=palette.INK)
    wide.set_ylim(len(sounds) - 0.5, -0.5)
    wide.tick_params(axis="y", length=0)
    heard = values[f"{CONTRAST} of the scene", "in"] or 0.0
    contrast.axvline(heard, ymax=0.9, color=palette.HAIRLINE, lw=3.0)
    contrast.text(heard, -0.65, f"heard: {heard:.0f} phon", fontsize=SMALL_PT, ha="center")
    for axis, title in ((contrast, f"{CONTRAST} of the scene"), (silence, SILENT)):
        for place, name in enumerate(names):
            value = values[title, name] or 0.0
            axis.barh(place, value, height=0.62, color=colours[name])
            number_beside(axis, f"{value:.1f}", (value, place))
        axis.set_yticks([])
        axis.set_ylim(len(names) - 0.4, -1.1)
        axis.margins(x=0.25)
    return figure


def speech(report: BenchReport) -> Figure:
    """Draw the level of the vibration over time with and without suppression, by voice."""
    series = report.section("Effects under speech").series
    voices = [name.removesuffix(", off") for name in series if name.endswith(", off")]
    figure = sheet(
        "What is felt of speech, and of an explosion in it",
        f"Level of the vibration in dB over time in s, without suppression and with "
        f"{SUPPRESSION_DB:g} dB of it; an explosion as loud as the speech comes at "
        f"{EFFECT_AT_S:g} s",
        4.4,
    )
    looks = {"off": (palette.HEARD_LIGHT, 2.6), "on": (palette.FELT, 1.4)}
    legend(figure, 0.06, [("■", palette.HEARD_LIGHT, "off"), ("■", palette.FELT, "suppressed")])
    axes = np.atleast_1d(figure.subplots(1, len(voices), sharey=True))
    figure.subplots_adjust(left=0.06, right=0.985, top=0.76, bottom=0.125, wspace=0.06)
    for axis, voice in zip(axes, voices, strict=True):
        frame(axis, voice, grid=True, unit="s")
        limit(axis, EFFECT_AT_S)
        for way, (colour, width) in looks.items():
            levels_db = np.array(series[f"{voice}, {way}"])
            time_s = (np.arange(levels_db.size) + 0.5) * COURSE_S
            axis.plot(time_s, levels_db, color=colour, lw=width)
        axis.set_ylim(LEAST_DB, 0.0)
        axis.margins(x=0.0)
    axes[0].set_title("dB", fontsize=TEXT_PT, color=palette.GREY, loc="left", x=-0.055)
    return figure

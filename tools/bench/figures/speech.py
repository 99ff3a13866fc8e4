"""The picture of speech suppression: the vibration of speech and of an explosion in it, both ways.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tools.bench.report import BenchReport
from tools.bench.sections.speech_suppression import (
    COURSE_S,
    EFFECT_AT_S,
    EFFECTS_TITLE,
    LEAST_DB,
    SUPPRESSION_DB,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 4.4
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 9.0, 14.0


def speech_figure(report: BenchReport) -> Figure:
    """The level of the vibration over time without and with suppression, a panel for each voice."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    series = report.section(EFFECTS_TITLE).series
    voices = [name.removesuffix(", off") for name in series if name.endswith(", off")]
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(0.02, 0.945, "What is felt of speech, and of an explosion in it",
                fontsize=TITLE_PT, color=palette.INK, va="center")  # fmt: skip
    figure.text(
        0.02, 0.885, "Level of the vibration in dB over time in s, without suppression and with "
        f"{SUPPRESSION_DB:g} dB of it; an explosion as loud as the speech comes at "
        f"{EFFECT_AT_S:g} s",
        fontsize=SMALL_PT, color=palette.GREY, va="center",
    )  # fmt: skip
    axes = np.atleast_1d(figure.subplots(1, len(voices), sharey=True))
    figure.subplots_adjust(left=0.06, right=0.985, top=0.735, bottom=0.125, wspace=0.06)
    for axis, voice in zip(axes, voices, strict=True):
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.spines["bottom"].set_color(palette.HAIRLINE)
        axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)
        axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
        axis.set_title(voice, fontsize=TEXT_PT, color=palette.INK)
        axis.axvline(EFFECT_AT_S, color=palette.INK, lw=0.9, ls=(0, (4, 3)), zorder=1)
        for way, colour, width in (("off", palette.HEARD_LIGHT, 2.6), ("on", palette.FELT, 1.4)):
            levels_db = np.array(series[f"{voice}, {way}"])
            time_s = (np.arange(levels_db.size) + 0.5) * COURSE_S
            axis.plot(time_s, levels_db, color=colour, lw=width)
        axis.set_ylim(LEAST_DB, 0.0)
        axis.margins(x=0.0)
        axis.set_xlabel("s", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=0)
    axes[0].set_title("dB", fontsize=TEXT_PT, color=palette.GREY, loc="left", x=-0.055)
    for x, colour, name in ((0.06, palette.HEARD_LIGHT, "off"), (0.13, palette.FELT, "suppressed")):
        figure.text(x, 0.82, "■", color=colour, fontsize=TEXT_PT + 2, va="center")
        figure.text(x + 0.019, 0.82, name, color=palette.INK, fontsize=TEXT_PT, va="center")
    return figure

"""The picture of levels: how strong sounds are felt at two volumes, and what stands above what.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tools.bench.report import BenchReport
from tools.bench.sections.levels import CONTRAST, SILENT, TITLE, ways

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 5.0
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 8.5, 14.0
LOUDEST = ", loudest tenth"
LOW = ", -20 dB"
PITCH = 0.15


def levels_figure(report: BenchReport) -> Figure:
    """For each sound and way a line from its level at -20 dB to that at full volume; two bars."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    values = {(row.name, row.column): row.value for row in report.section(TITLE).rows}
    names = [way.name for way in ways()]
    sounds = [
        name.removesuffix(LOUDEST) for name, column in values if column == "in" and
        name.endswith(LOUDEST)
    ]  # fmt: skip
    colours = dict(
        zip(
            names,
            (palette.HEARD, palette.HEARD_LIGHT, palette.FELT, palette.FELT_LIGHT, palette.INK),
            strict=True,
        )
    )
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(
        0.02, 0.945, "How strong a sound is felt", fontsize=TITLE_PT, color=palette.INK, va="center"
    )
    figure.text(
        0.02, 0.89,
        "Left: the loudest tenth of the units; dot: at full volume, end of the line: played 20 dB "
        "lower. Right: how far an explosion stands above speech; units not felt",
        fontsize=SMALL_PT, color=palette.GREY, va="center",
    )  # fmt: skip
    wide, contrast, silence = figure.subplots(1, 3, width_ratios=(3.0, 1.2, 1.2))
    figure.subplots_adjust(left=0.115, right=0.985, top=0.755, bottom=0.09, wspace=0.28)
    for axis in (wide, contrast, silence):
        _plain(axis)
    for line, sound in enumerate(sounds):
        title = f"{sound}{LOUDEST}"
        for mark in (values[title, "in"], values[title + LOW, "in"]):
            wide.plot([mark, mark], [line - 0.36, line + 0.36], color=palette.HAIRLINE, lw=3.0)
        for number, name in enumerate(names):
            place = line + (number - 2) * PITCH
            full, low = values[title, name], values[title + LOW, name]
            wide.plot([low, full], [place, place], color=colours[name], lw=1.6)
            wide.plot([full], [place], "o", ms=5, color=colours[name])
    wide.set_yticks(range(len(sounds)), sounds, fontsize=TEXT_PT, color=palette.INK)
    wide.set_ylim(len(sounds) - 0.5, -0.5)
    wide.tick_params(axis="y", length=0)
    wide.set_xlabel(
        "dB of full scale",
        fontsize=SMALL_PT,
        color=palette.GREY,
        loc="right",
    )
    heard = values[f"{CONTRAST} of the scene", "in"]
    contrast.axvline(heard, ymax=0.9, color=palette.HAIRLINE, lw=3.0)
    contrast.set_title("explosion over speech, dB", fontsize=SMALL_PT + 0.5, color=palette.INK)
    silence.set_title("not felt at -20 dB, %", fontsize=SMALL_PT + 0.5, color=palette.INK)
    for axis, title in ((contrast, f"{CONTRAST} of the scene"), (silence, SILENT)):
        for number, name in enumerate(names):
            value = values[title, name] or 0.0
            axis.barh(number, value, height=0.62, color=colours[name])
            axis.text(
                value, number, f" {value:.1f}", fontsize=SMALL_PT, color=palette.GREY, va="center"
            )
        axis.set_yticks([])
        axis.set_ylim(len(names) - 0.4, -1.1)
        axis.margins(x=0.25)
    contrast.text(
        heard or 0.0, -0.65, f"heard: {heard:.0f} phon", fontsize=SMALL_PT, color=palette.GREY,
        va="bottom", ha="center",
    )  # fmt: skip
    for number, name in enumerate(names):
        x = 0.115 + 0.14 * number
        figure.text(x, 0.835, "●", color=colours[name], fontsize=TEXT_PT + 1, va="center")
        figure.text(x + 0.018, 0.835, name, color=palette.INK, fontsize=TEXT_PT, va="center")
    x = 0.115 + 0.14 * len(names)
    figure.text(x, 0.835, "▮", color=palette.HAIRLINE, fontsize=TEXT_PT + 1, va="center")
    figure.text(
        x + 0.018, 0.835, "the sound itself", color=palette.INK, fontsize=TEXT_PT, va="center"
    )
    return figure


def _plain(axis: Axes) -> None:
    from audioflinger_hook.figures import palette

    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.spines["bottom"].set_color(palette.HAIRLINE)
    axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)

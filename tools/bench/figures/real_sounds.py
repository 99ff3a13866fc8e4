"""The picture of levels of a film, a drum, a slow crescendo and a chord."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import SMALL_PT, frame, sheet
from tools.bench.report import BenchReport
from tools.bench.sections.felt_films import BLOWS, FILM, PARTS, SHOWN_S, SOUND
from tools.bench.sections.felt_levels import END_S, SWELL
from tools.bench.sections.felt_times import CHORD, CHORD_STEP_S, DRUM, DRUM_BEFORE_S

OTHERS = "#b9c0c7"
COLOURS = {
    "paper": palette.GREY, "cinema": palette.FELT, "game": palette.FELT_LIGHT, "music": palette.INK,
    "speech": palette.HEARD_LIGHT,
}  # fmt: skip
HEIGHT_IN = 9.4
NAMED = ("dialogue", "quiet", "action", "hiss", "dialogue")
LOWEST_DB, HIGHEST_DB = -30.0, 20.0  # range in dB of a film's curves, relative to its dialogue

Series = Mapping[str, tuple[float, ...]]


def real_sounds(report: BenchReport) -> Figure:
    """Draw the levels of a film over time, for the sound and each method.

    Below the film, a drum, a crescendo and a chord are drawn for each profile.
    """
    series = report.section("On real sounds").series
    profiles = [name for name in PROFILES if f"{FILM}{name}" in series]
    methods = [name.removeprefix(FILM) for name in series if name.startswith(FILM)]
    figure = sheet(
        "A film, heard and felt",
        f"Level over time against the film's own dialogue (line), {LOWEST_DB:g} to "
        f"{HIGHEST_DB:g} dB. Dots: explosions",
        HEIGHT_IN,
    )
    above = figure.add_gridspec(
        len(methods), 1, left=0.115, right=0.985, top=0.885, bottom=0.40, hspace=0.12
    )
    ordered = [SOUND, *profiles[1:], profiles[0]] if profiles else [SOUND]
    ordered += [name for name in methods if name not in ordered]
    for place, name in enumerate(ordered):
        axis = figure.add_subplot(above[place, 0])
        _strip(axis, series, name)
        if not place:
            _name_parts(axis, series)
        if place < len(ordered) - 1:
            axis.tick_params(labelbottom=False)
            axis.set_xlabel("")
    below = figure.add_gridspec(1, 3, left=0.07, right=0.985, top=0.30, bottom=0.055, wspace=0.24)
    _drum(figure.add_subplot(below[0, 0]), series, profiles)
    _swell(figure.add_subplot(below[0, 1]), series, profiles)
    _chord(figure.add_subplot(below[0, 2]), series, profiles)
    return figure


def _strip(axis: Axes, series: Series, name: str) -> None:
    level = np.clip(np.array(series[f"{FILM}{name}"]), LOWEST_DB, HIGHEST_DB)
    time_s = (np.arange(level.size) + 0.5) * SHOWN_S
    colour = palette.HEARD if name == SOUND else COLOURS.get(name, OTHERS)
    for end_s in series[PARTS]:
        axis.axvline(end_s, color=palette.HAIRLINE, lw=0.8, zorder=1)
    axis.axhline(0.0, color=palette.HAIRLINE, lw=0.8, zorder=1)
    axis.fill_between(time_s, LOWEST_DB, level, color=colour, alpha=0.35, lw=0, zorder=2)
    axis.plot(time_s, level, color=colour, lw=0.9, zorder=3)
    strokes = np.array(series[BLOWS])
    places = np.minimum((strokes / SHOWN_S).astype(int), level.size - 5)
    tops = [float(level[place : place + 5].max()) for place in places]
    axis.plot(strokes + 0.25, tops, "o", ms=3.4, color=colour, mec="white", mew=0.5, zorder=4)
    frame(axis, unit="s")
    axis.set_xlim(0.0, time_s[-1])
    axis.set_ylim(LOWEST_DB, HIGHEST_DB)
    axis.set_yticks([0.5 * (LOWEST_DB + HIGHEST_DB)], [name])
    axis.tick_params(axis="y", length=0, labelcolor=palette.INK)


def _name_parts(axis: Axes, series: Series) -> None:
    ends = [0.0, *series[PARTS], axis.get_xlim()[1]]
    for name, first, last in zip(NAMED, ends, ends[1:], strict=False):
        axis.text(
            0.5 * (first + last), HIGHEST_DB + 3.0, name, fontsize=SMALL_PT, color=palette.GREY,
            ha="center", va="bottom",
        )  # fmt: skip


def _drum(axis: Axes, series: Series, names: list[str]) -> None:
    shown = {"sound": palette.HEARD} | {name: COLOURS.get(name, OTHERS) for name in names}
    for line, (name, colour) in enumerate(shown.items()):
        level = np.array(series[f"{DRUM}{name}"])
        time_ms = np.arange(level.size) - 1e3 * DRUM_BEFORE_S
        share = 0.85 * level / max(float(level.max()), 1e-9)
        axis.fill_between(time_ms, -line, share - line, color=palette.HAIRLINE, lw=0)
        axis.plot(time_ms, share - line, color=colour, lw=1.4)
        half = time_ms[int((share >= 0.5 * share.max()).argmax())]
        axis.plot([half], [0.425 - line], "o", ms=4.5, color=colour, mec="white", mew=0.6)
    frame(axis, "a drum; dots: half of the peak", unit="ms")
    axis.set_yticks([0.25 - line for line in range(len(shown))], list(shown))
    axis.tick_params(axis="y", length=0, labelcolor=palette.INK)
    axis.axvline(0.0, color=palette.HAIRLINE, lw=0.8, zorder=0)


def _swell(axis: Axes, series: Series, names: list[str]) -> None:
    shown = {"heard, phon": ("sound", palette.HEARD)}
    shown |= {f"{name}, dB": (name, COLOURS.get(name, OTHERS)) for name in names}
    for label, (name, colour) in shown.items():
        level = np.array(series[f"{SWELL}{name}"])
        time_s = (np.arange(level.size) + 0.5) * END_S
        level = level - level[round(8.0 / END_S) - 1 : round(8.0 / END_S) + 1].mean()
        axis.plot(time_s, level, color=colour, lw=1.6, label=label)
    frame(axis, "a swell of 30 dB up and down", grid=True, unit="s")
    axis.set_xlim(0.0, 40.0)
    axis.set_ylim(-6.0, 44.0)
    axis.legend(fontsize=SMALL_PT - 1.0, frameon=False, loc="upper left", handlelength=1.2)


def _chord(axis: Axes, series: Series, names: list[str]) -> None:
    for line, name in enumerate(names):
        level = np.array(series[f"{CHORD}{name}"])
        time_s = np.arange(level.size) * CHORD_STEP_S
        share = level / max(float(level.mean()), 1e-9)
        axis.plot([0.0, time_s[-1]], [1.0 - 2.0 * line] * 2, color=palette.HAIRLINE, lw=0.8)
        axis.plot(time_s, share - 2.0 * line, color=COLOURS.get(name, OTHERS), lw=1.2)
    frame(axis, "a steady A-major chord", unit="s")
    axis.set_yticks([1.0 - 2.0 * line for line in range(len(names))], names)
    axis.tick_params(axis="y", length=0, labelcolor=palette.INK)
